"""The benchmark: what is asked, played, stored, continued, summarised, drawn and printed."""

import csv
import dataclasses
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fake_episodes import (
    HARD,
    MEDIUM,
    fails_at_seed_two,
    fake_play,
    is_killed_at_seed_two,
    manifest,
    without_times,
)
from rich.console import Console
from typer.testing import CliRunner

from smp_gym.datasets.frozen import FrozenEpisode, list_path, load_episodes, write_episodes
from smp_gym.suites import SUITES, Cell
from smp_planner.benchmark import runner, worker_pool
from smp_planner.benchmark.cli import app
from smp_planner.benchmark.episodes import TIMES, EpisodeKey, EpisodeRow
from smp_planner.benchmark.manifest import EpisodeStore, make_manifest, read_results
from smp_planner.benchmark.results_folder import ResultsError
from smp_planner.benchmark.summary import (
    CSV_COLUMNS,
    overview,
    summarise,
    tables,
    write_csv,
)

# What is asked


def test_every_method_plays_the_same_seeds() -> None:
    keys = manifest(3, seed=10).episode_keys()
    assert len(set(keys)) == len(keys) == 6
    for method in ("smp", "promp"):
        assert [key.seed for key in keys if key.method == method] == [10, 11, 12]


def test_manifest_records_what_decides_the_rows() -> None:
    import torch

    made = make_manifest([MEDIUM], ["smp"], 5, 7)
    assert made.versions["torch"].split("+")[0] == torch.__version__.split("+")[0]
    assert made.versions["numpy"] == np.__version__
    assert made == make_manifest([MEDIUM], ["smp"], 5, 7)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([MEDIUM], ["spm"], 0, 1), "unknown method 'spm'; there are: smp, promp"),
        (([], ["smp"], 0, 1), "name each cell once and at least one"),
        (([MEDIUM, MEDIUM], ["smp"], 0, 1), "name each cell once"),
        (([MEDIUM], [], 0, 1), "at least one"),
        (([MEDIUM], ["smp", "smp"], 0, 1), "once"),
        (([MEDIUM], ["smp"], -1, 1), "seed must not be negative, got -1"),
        (([MEDIUM], ["smp"], 0, 0), "episodes must be at least 1, got 0"),
    ],
)
def test_unknown_names_list_what_exists(arguments: tuple[Any, ...], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make_manifest(*arguments)


@pytest.fixture(scope="module")
def lists(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a list of four episodes, in two halves, and one that nobody solved."""
    folder = tmp_path_factory.mktemp("lists")
    episodes = [
        FrozenEpisode(half, seed, HARD.scene(seed), "reference")
        for seed in (3, 4)
        for half in ("witness", "placed")
    ]
    unknown = [FrozenEpisode("placed", 5, HARD.scene(5))]
    write_episodes(list_path(HARD, folder), {}, episodes, unknown)
    return folder


def test_frozen_lists_are_asked_for_by_seed_and_half(lists: Path) -> None:
    made = make_manifest([HARD], ["smp", "promp"], 0, 3, frozen=True, lists=lists)
    keys = made.episode_keys()
    listed = [(e.seed, e.half) for e in load_episodes(HARD, lists)[:3]]
    for method in ("smp", "promp"):
        assert [(k.seed, k.half) for k in keys if k.method == method] == listed
    assert [(k.method, k.seed, k.half) for k in made.first_keys()] == [
        ("smp", *listed[0]),
        ("promp", *listed[0]),
    ]


@pytest.mark.parametrize(
    ("cell", "seed", "episodes", "message"),
    [
        (Cell("Placement", "none"), 0, 1, "no frozen list of Placement_none"),
        (MEDIUM, 0, 1, "no frozen list of Placement_medium, .* there are: Placement_hard"),
        (HARD, 3, 1, "seed must be 0, got 3"),
        (HARD, 0, 5, "hold 4 episodes, got episodes 5"),
    ],
)
def test_frozen_lists_that_do_not_exist_are_refused(
    lists: Path, cell: Cell, seed: int, episodes: int, message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        make_manifest([cell], ["smp"], seed, episodes, frozen=True, lists=lists)


def test_a_cell_is_in_every_key_and_in_the_titles() -> None:
    cells = [Cell("Placement", "medium", "shelf"), Cell("DrawS", "easy", sensing="depth"), MEDIUM]
    made = make_manifest(cells, ["smp"], 0, 2)
    keys = made.episode_keys()
    assert [(key.cell, key.seed) for key in keys] == [(c, seed) for seed in (0, 1) for c in cells]
    assert made.first_keys() == keys[:3]
    rows = [fake_play(key) for key in keys]
    assert [row.key for row in rows] == keys
    titles = [table.title for table in tables(summarise(made, rows))]
    assert titles == [f"{cell.name}, seeds 0–1" for cell in cells]


# What is exported


def test_csv_is_sorted_and_ends_with_the_times(tmp_path: Path) -> None:
    keys = manifest().episode_keys()
    write_csv(tmp_path / "rows.csv", [fake_play(key) for key in reversed(keys)])
    with (tmp_path / "rows.csv").open() as file:
        header, *rows = list(csv.reader(file))
    assert tuple(header) == CSV_COLUMNS
    assert tuple(header[-3:]) == TIMES[:3]
    found = [(row[0], row[1], row[2], int(row[3])) for row in rows]
    assert found == sorted((k.task, k.method, k.difficulty, k.seed) for k in keys)
    assert float(rows[0][header.index("goal_error")]) == fake_play(min(keys)).goal_error


# What is played


def test_rows_of_two_spawned_workers_are_those_of_this_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They compute on one thread each, whatever the environment says."""
    monkeypatch.setattr(worker_pool, "START", "spawn")
    monkeypatch.setenv("OMP_NUM_THREADS", "2")
    before = dict(os.environ)
    keys = sorted(manifest().episode_keys())
    rows = runner.run(manifest(), tmp_path, jobs=2, player=reports_threads)
    assert dict(os.environ) == before
    assert {row.message for row in rows} == {"1 1"}
    here = [dataclasses.replace(fake_play(key), message="1 1") for key in keys]
    assert without_times(rows) == without_times(here)
    assert [row.key for row in rows] == keys


def reports_threads(key: EpisodeKey) -> EpisodeRow:
    import torch

    message = f"{torch.get_num_threads()} {os.environ['OMP_NUM_THREADS']}"
    return dataclasses.replace(fake_play(key), message=message)


def test_a_run_continues_with_the_missing_episodes_only(tmp_path: Path) -> None:
    runner.run(manifest(2), tmp_path, player=fake_play)
    before = read_results(tmp_path)[1]
    seen: list[tuple[int, int]] = []
    rows = runner.run(
        manifest(4), tmp_path, player=fake_play, on_progress=lambda *count: seen.append(count)
    )
    assert seen[0] == (4, 8)
    assert seen[-1] == (8, 8)
    # Their times tell them from rows that were played again.
    assert read_results(tmp_path)[1][: len(before)] == before
    # One worker writes the rows that two do, and this process.
    here = [fake_play(key) for key in sorted(manifest(4).episode_keys())]
    assert without_times(rows) == without_times(here)
    runner.run(manifest(4), tmp_path, player=is_killed_at_seed_two)


def test_an_exception_names_the_episode_and_keeps_the_rest(tmp_path: Path) -> None:
    with pytest.raises(runner.EpisodeFailedError, match=r"seed=2.*a goal out of reach"):
        runner.run(manifest(), tmp_path, player=fails_at_seed_two)
    kept = {row.seed for row in read_results(tmp_path)[1]}
    assert {0, 1} <= kept
    assert 2 not in kept
    assert len(runner.run(manifest(), tmp_path, player=fake_play)) == 8


def test_a_killed_worker_keeps_the_rows_and_says_how_to_go_on(tmp_path: Path) -> None:
    with pytest.raises(runner.WorkerDiedError, match=r"are kept in .*same command continues"):
        runner.run(manifest(), tmp_path, player=is_killed_at_seed_two)
    assert {row.seed for row in read_results(tmp_path)[1]} >= {0}
    assert len(runner.run(manifest(), tmp_path, player=fake_play)) == 8


def test_jobs_must_be_positive(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="jobs must be at least 1, got 0"):
        runner.run(manifest(), tmp_path, jobs=0)


SLOW_RUN = """
import signal
import sys

# What runs in the background of a shell may have been told to disregard it.
signal.signal(signal.SIGINT, signal.default_int_handler)
sys.path[:0] = {paths!r}
from pathlib import Path

from smp_gym.datasets.frozen import load_episodes
from smp_planner.benchmark import runner
from smp_planner.benchmark.options import run_command
from fake_episodes import manifest, slow_play

def main():
    runner.run(manifest(40), Path({out!r}), jobs=1, player=slow_play)

if __name__ == "__main__":
    run_command(main)
"""


def test_ctrl_c_leaves_a_folder_that_can_be_continued(tmp_path: Path) -> None:
    script = tmp_path / "slow.py"
    out = tmp_path / "out"
    paths = [str(Path(__file__).parent), str(Path(__file__).parents[3])]
    script.write_text(SLOW_RUN.format(paths=paths, out=str(out)))
    process = subprocess.Popen([sys.executable, str(script)], start_new_session=True)
    _wait_until(lambda: _begun(out), 240.0)
    os.killpg(process.pid, signal.SIGINT)
    assert process.wait(timeout=30) == 130
    kept = read_results(out)[1]
    assert 1 <= len(kept) < 80
    with EpisodeStore(out, manifest(40)) as store:
        assert len(store.missing(manifest(40).episode_keys())) == 80 - len(kept)


def _begun(out: Path) -> bool:
    """Return whether a run has written a row; looking at it does not disturb it."""
    try:
        return bool(read_results(out)[1])
    except ResultsError:
        return False


def _wait_until(condition: Callable[[], bool], seconds: float) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "timed out"
        time.sleep(0.05)


# What is summarised


def test_summary_counts_by_method_and_is_json() -> None:
    rows = [fake_play(key) for key in manifest(30).episode_keys()]
    summary = json.loads(json.dumps(summarise(manifest(30), rows), allow_nan=False))
    assert [group["method"] for group in summary["groups"]] == ["smp", "promp"]
    for group in summary["groups"]:
        of_method = [row for row in rows if row.method == group["method"]]
        assert group["episodes"] == 30
        assert group["success"]["value"] == sum(row.success for row in of_method) / 30
        errors = [row.goal_error for row in of_method]
        assert group["goal_error"]["value"] == pytest.approx(np.mean(errors))
        assert group["causes"] == {"collision": sum(row.collision for row in of_method)}
        assert group["chosen_clearance"] is None


def test_table_shows_every_group() -> None:
    rows = [fake_play(key) for key in manifest(5).episode_keys()]
    (shown,) = tables(summarise(manifest(5), rows))
    assert len(shown.columns) == 3


def test_an_overview_has_a_line_for_each_cell() -> None:
    made = manifest(5, cells=(MEDIUM, HARD), suite="standard")
    rows = [fake_play(key) for key in made.episode_keys() if key.cell == HARD]
    summary = summarise(made, rows)
    assert [table.title for table in tables(summary)] == ["Placement_hard, seeds 0–4"]
    console = Console(width=100)
    with console.capture() as shown:
        console.print(overview(summary))
    rate = 100.0 * sum(row.success for row in rows if row.method == "smp") / 5
    lines = [line.split("│")[1:3] for line in shown.get().splitlines() if "Placement_" in line]
    assert [name.strip() for name, _ in lines] == ["Placement_medium", "Placement_hard"]
    assert lines[0][1].strip() == "–"
    assert lines[1][1].strip().startswith(f"{rate:.1f} (")


def test_halves_of_a_frozen_list_are_summarised_apart(tmp_path: Path, lists: Path) -> None:
    made = manifest(4, cells=(HARD,), frozen=True, lists=str(lists))
    rows = [fake_play(key) for key in made.episode_keys()]
    summary = json.loads(json.dumps(summarise(made, rows), allow_nan=False))
    for group in summary["groups"]:
        assert list(group["halves"]) == ["witness", "placed"]
        for half, part in group["halves"].items():
            of_half = [r for r in rows if (r.method, r.half) == (group["method"], half)]
            assert part["episodes"] == len(of_half) == 2
            assert part["success"]["value"] == sum(row.success for row in of_half) / 2
    console = Console(width=100)
    with console.capture() as shown:
        console.print(*tables(summary))
    for text in ("frozen list", "witness half", "placed half"):
        assert text in shown.get()
    write_csv(tmp_path / "rows.csv", rows)
    with (tmp_path / "rows.csv").open() as file:
        assert {row["half"] for row in csv.DictReader(file)} == {"witness", "placed"}
    drawn = [fake_play(key) for key in manifest(2).episode_keys()]
    assert all(g["halves"] == {} for g in summarise(manifest(2), drawn)["groups"])


# What is typed


def test_list_names_what_exists() -> None:
    result = CliRunner().invoke(app, ["list"])
    assert result.exit_code == 0
    for name in ("Placement", "smp", "promp", "none", "easy", "medium", "hard", "100000", "200000"):
        assert name in result.output
    for name in SUITES:
        assert f"suite {name}" in result.output


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--tasks", "Chess"], "there are: Placement"),
        (["--methods", "smp,spm"], "there are: smp, promp"),
        (["--difficulty", "huge"], "there are: none, easy, medium, hard"),
        (["--family", "sofa"], "there are: obstacles, shelf, box, cage, table"),
        (["--sensing", "sonar"], "there are: exact, noise, depth"),
        (["--sensing", "noise", "--noise", "-1"], "noise must be positive"),
        (["--suite", "loose"], "unknown suite 'loose'; there are: standard, tight"),
        (["--suite", "standard", "--cells", "DrawS_huge"], "there are: Placement_easy"),
        (["--suite", "standard", "--difficulty", "easy"], "--difficulty is of single cells"),
        (["--suite", "standard", "--lists", "nowhere"], "no frozen list of Placement_easy"),
        (["--lists", "nowhere"], "--lists needs --frozen"),
        (["--suite", "standard", "--seed", "0", "--lists", "nowhere"], "--lists needs --frozen"),
        (["--cells", "DrawS_easy"], "--cells needs --suite"),
        (["--episodes", "0"], "--episodes"),
        (["--frozen", "--seed", "7"], "seed must be 0, got 7"),
        (["--frozen", "--difficulty", "none"], "no frozen list"),
        (["--jobs", "0"], "--jobs"),
    ],
)
def test_bad_options_are_answered_with_what_exists(
    tmp_path: Path, options: list[str], message: str
) -> None:
    result = CliRunner().invoke(app, ["run", "--out", str(tmp_path / "out"), *options])
    assert result.exit_code == 2
    assert message in result.output
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "arguments",
    [
        ("run", "--methods", "promp", "--episodes", "1", "--out", "{}/file"),
        ("run", "--methods", "promp", "--episodes", "1", "--out", "{}/file/below"),
        ("draw", "--out", "{}/file/below"),
    ],
)
def test_a_path_that_cannot_be_a_folder_is_refused_before_work(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...]
) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(SystemExit) as ended:
        app([argument.format(tmp_path) for argument in arguments])
    assert ended.value.code == 2
    said = capsys.readouterr().err
    assert "Invalid value for" in said
    assert "--out" in said
    assert (tmp_path / "file").read_bytes() == b""


@pytest.mark.parametrize(
    "arguments",
    [
        ("show", "{}/damaged"),
        ("show", "{}/torn"),
        ("export", "{}/torn"),
        ("import", "{}/torn", "--out", "{}/new"),
    ],
)
def test_an_error_of_the_system_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...]
) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "damaged/results.sqlite").mkdir(parents=True)
    (tmp_path / "torn").mkdir()
    (tmp_path / "torn/results.sqlite").write_bytes(b"SQLite format 3" + bytes(100))
    before = signal.getsignal(signal.SIGTERM)
    with pytest.raises(SystemExit) as ended:
        app([argument.format(tmp_path) for argument in arguments])
    assert ended.value.code == 2
    assert signal.getsignal(signal.SIGTERM) == before
    # Before it there may be a progress bar.
    lines = capsys.readouterr().err.splitlines()
    lines = [line for line in lines if not line.startswith("episodes ")]
    assert [line[:7] for line in lines] == ["error: "]
    assert str(tmp_path) in lines[0]


def test_run_into_other_results_is_refused(tmp_path: Path) -> None:
    with EpisodeStore(tmp_path, manifest()):
        pass
    result = CliRunner().invoke(app, ["run", "--out", str(tmp_path), "--episodes", "4"])
    assert result.exit_code == 2
    assert "other settings" in result.output


def test_show_prints_the_table_of_an_unfinished_run(tmp_path: Path) -> None:
    with EpisodeStore(tmp_path, manifest()) as store:
        store.append(fake_play(manifest().episode_keys()[0]))
    result = CliRunner().invoke(app, ["show", str(tmp_path)])
    assert result.exit_code == 0
    assert "success" in result.output
    assert "unfinished: 1 of 8 episodes" in result.output
    as_json = CliRunner().invoke(app, ["show", "--json", str(tmp_path)])
    assert json.loads(as_json.output)["groups"][0]["episodes"] == 1


def test_show_of_nothing_is_an_error(tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["show", str(tmp_path / "nowhere")])
    assert result.exit_code == 2
    assert "holds no results" in result.output
