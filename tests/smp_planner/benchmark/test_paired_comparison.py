"""Folders joined, and two methods compared on real rows against counts made by hand."""

import csv
import gzip
import json
import re
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from real_rows import TASKS, real_rows, write_folder
from scipy import stats
from typer.testing import CliRunner

from smp_gym.suites import Cell
from smp_planner.benchmark.cli import app
from smp_planner.benchmark.episodes import EpisodeRow
from smp_planner.benchmark.joined_results import completion_time, join_results, suite_of
from smp_planner.benchmark.paired_comparison import compare_methods, compare_pairs
from smp_planner.benchmark.results_folder import ResultsError

HERE = Path(__file__).parent


def _table() -> list[dict[str, str]]:
    """Return the rows as the file of this folder holds them, without our code."""
    with gzip.open(HERE / "hard_rows.csv.gz", "rt", newline="") as file:
        return list(csv.DictReader(file))


def _outcomes(method: str, task: str = "") -> dict[tuple[str, str], bool]:
    return {
        (row["task"], row["seed"]): row["success"] == "True"
        for row in _table()
        if row["method"] == method and task in ("", row["task"])
    }


def test_comparisons_count_what_the_rows_hold(hard: Path) -> None:
    comparisons = compare_methods(join_results([hard]), "smp", "rrt_connect")
    # Cells are tasks here, and difficulty and suite take all of them together.
    assert [each.level for each in comparisons] == ["cell"] * 4 + ["difficulty"]
    for each, task in zip(comparisons, (*TASKS, ""), strict=True):
        first, second = _outcomes("smp", task), _outcomes("rrt_connect", task)
        pairs = Counter((first[key], second[key]) for key in first)
        assert each.counts.both == pairs[True, True]
        assert each.counts.first_only == pairs[True, False]
        assert each.counts.second_only == pairs[False, True]
        assert each.counts.neither == pairs[False, False]
        assert each.first_rate["value"] == pytest.approx(np.mean(list(first.values())))
        times = [
            float(row["planning_time"])
            for row in _table()
            if row["method"] == "rrt_connect" and task in ("", row["task"])
        ]
        assert each.times is not None
        solve = each.times.second_solve
        assert (solve.median, solve.p75, solve.p98) == pytest.approx(
            tuple(np.percentile(times, [50, 75, 98]))
        )
    assert [each.verdict for each in comparisons] == [*["cannot tell"] * 4, "better"]


def test_motion_is_compared_where_both_succeed(hard: Path) -> None:
    *_, task, _ = compare_methods(join_results([hard]), "smp", "rrt_connect")
    assert task.name == "PushLiftBox_hard"
    steps = {
        method: {r["seed"]: int(r["steps"]) for r in _table() if r["task"] == "PushLiftBox"
                 and r["method"] == method and r["success"] == "True"}
        for method in ("smp", "rrt_connect")
    }  # fmt: skip
    both = steps["smp"].keys() & steps["rrt_connect"].keys()
    differences = [(steps["smp"][s] - steps["rrt_connect"][s]) / 20 for s in both]
    assert task.times is not None
    motion = task.times.motion
    assert motion is not None
    assert motion.difference["count"] == len(both) == 5
    assert motion.difference["value"] == pytest.approx(np.mean(differences))
    assert motion.first == pytest.approx(np.mean([steps["smp"][s] for s in both]) / 20)


def test_the_other_order_has_the_other_verdict(hard: Path) -> None:
    results = join_results([hard])
    forth = compare_methods(results, "smp", "rrt_connect")[-1]
    back = compare_methods(results, "rrt_connect", "smp")[-1]
    assert (forth.verdict, back.verdict) == ("better", "worse")
    assert forth.p_value == back.p_value
    assert forth.difference["value"] == -back.difference["value"]


def test_pairs_are_corrected_together(hard: Path) -> None:
    results = join_results([hard])
    pairs = compare_pairs(results, results.methods, results.common())
    assert [(p.first, p.second) for p in pairs] == [
        ("smp", "cpromp"),
        ("smp", "rrt_connect"),
        ("cpromp", "rrt_connect"),
    ]
    by_hand = [
        stats.binomtest(p.counts.first_only, p.counts.first_only + p.counts.second_only).pvalue
        for p in pairs
    ]
    assert [p.p_value for p in pairs] == pytest.approx(by_hand)
    corrected = sorted(p.corrected for p in pairs)
    assert corrected[0] == pytest.approx(3 * min(by_hand))
    assert all(p.corrected >= p.p_value for p in pairs)


def test_folders_of_the_same_episodes_are_joined(hard: Path, tmp_path: Path) -> None:
    write_folder(tmp_path / "one", TASKS[3:], ("smp",))
    write_folder(tmp_path / "two", TASKS[3:], ("rrt_connect",))
    results = join_results([tmp_path / "one", tmp_path / "two"])
    (together,) = compare_methods(results, "smp", "rrt_connect")
    alone = compare_methods(join_results([hard]), "smp", "rrt_connect")[3]
    assert (together.counts, together.times) == (alone.counts, alone.times)


def test_two_versions_of_a_method_are_told_apart_by_their_folders(tmp_path: Path) -> None:
    def worse(row: EpisodeRow) -> EpisodeRow:
        return replace(row, success=row.success and row.seed != 79400)

    write_folder(tmp_path / "old", TASKS, ("smp",), 2, change=worse, code="other")
    write_folder(tmp_path / "new", TASKS, ("smp",), 2)
    results = join_results([tmp_path / "old", tmp_path / "new"])
    assert results.methods == ("smp@old", "smp@new")
    (*_, comparison) = compare_methods(results, "smp@new", "smp@old")
    assert (comparison.counts.first_only, comparison.counts.second_only) == (4, 0)
    versions, scenes = results.cautions()
    assert "different versions of the code" in versions
    assert "Not all rows hold their scene" in scenes


def test_equal_seeds_must_be_equal_scenes(tmp_path: Path) -> None:
    def drawn(row: EpisodeRow, version: int = 1) -> EpisodeRow:
        return replace(row, scene=f'{{"seed": {row.seed}, "version": {version}}}')

    def drawn_anew(row: EpisodeRow) -> EpisodeRow:
        return drawn(row, 2)

    write_folder(tmp_path / "a", TASKS[:1], ("smp",), 2, change=drawn, code="other")
    write_folder(tmp_path / "b", TASKS[:1], ("rrt_connect",), 2, change=drawn)
    write_folder(tmp_path / "c", TASKS[:1], ("cpromp",), 2, change=drawn_anew)
    assert len(join_results([tmp_path / "a", tmp_path / "b"]).cautions()) == 1
    with pytest.raises(ResultsError, match=r"episode 79400 of .*one scene in 'a'.*in 'c'"):
        join_results([tmp_path / "a", tmp_path / "c"])


def test_other_episodes_of_a_method_are_added(tmp_path: Path) -> None:
    write_folder(tmp_path / "a", TASKS[:1], episodes=2)
    write_folder(tmp_path / "b", TASKS[1:3], episodes=1, versions={"numpy": "2.2.6"})
    results = join_results([tmp_path / "a", tmp_path / "b"])
    assert results.methods == ("smp", "cpromp", "rrt_connect")
    assert [cell.task for cell in results.cells] == list(TASKS[:3])
    assert len(results.common()) == 4
    found = {e.cell.task: results.source("smp", e).name for e in results.common()}
    assert found == dict(zip(TASKS, "abb", strict=False))
    assert results.cautions() == ["The folders were written with different versions of numpy."]


def test_a_run_that_goes_on_is_told(tmp_path: Path) -> None:
    rows = write_folder(
        tmp_path / "a", TASKS[:1], episodes=3, change=lambda row: replace(row, seed=row.seed + 1)
    )
    results = join_results([tmp_path / "a"])
    assert len(rows) == 6
    assert results.cautions() == ["a is unfinished: 6 of 9 episodes."]


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (("smp", "spm"), "no rows of the method 'spm'; there are: smp, cpromp"),
        (("smp", "smp"), "got 'smp' twice"),
    ],
)
def test_methods_that_cannot_be_compared_are_named(
    hard: Path, names: tuple[str, str], message: str
) -> None:
    with pytest.raises(ResultsError, match=message):
        compare_methods(join_results([hard]), *names)


def test_folders_that_cannot_be_joined_are_named(hard: Path, tmp_path: Path) -> None:
    write_folder(tmp_path / "b", tasks=TASKS[:1], methods=("cpromp",), episodes=1)
    write_folder(tmp_path / "c", tasks=TASKS[1:2], methods=("smp",), episodes=1)
    with pytest.raises(ResultsError, match="no episode in common"):
        compare_methods(join_results([tmp_path / "b", tmp_path / "c"]), "smp", "cpromp")
    with pytest.raises(ResultsError, match="each folder once"):
        join_results([hard, hard / ".." / "hard"])
    with pytest.raises(ResultsError, match="at least one, got none"):
        join_results([])
    with pytest.raises(ResultsError, match="holds no results"):
        join_results([hard, tmp_path / "nowhere"])


def test_a_cell_s_suite_is_its_own_or_that_of_its_scenes() -> None:
    assert suite_of(Cell("Placement", "hard")) == "standard"
    assert suite_of(Cell("Placement", "easy", sensing="depth")) == "perception"
    assert suite_of(Cell("Placement", "hard", sensing="depth")) == "standard"
    assert suite_of(Cell("Placement", "none")) == "single cells"


def test_only_success_completes() -> None:
    for row in real_rows():
        if row.success:
            assert completion_time(row) == pytest.approx(row.planning_time + row.steps / 20)
        else:
            assert completion_time(row) == np.inf


def test_compare_prints_both_tables_and_json(hard: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "160")
    result = CliRunner().invoke(app, ["compare", str(hard), "smp", "rrt_connect"])
    assert result.exit_code == 0
    for text in ("98 (89–100)", "83 (70–91)", "7 : 0", "better", "both solve"):
        assert text in result.output
    as_json = CliRunner().invoke(app, ["compare", "--json", str(hard), "smp", "rrt_connect"])
    last = json.loads(as_json.output)["comparisons"][-1]
    assert (last["name"], last["verdict"], last["counts"]["first_only"]) == ("hard", "better", 7)


@pytest.mark.parametrize("arguments", [["compare"], ["compare", "a", "b"]])
def test_compare_says_what_it_needs(arguments: list[str]) -> None:
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 2
    assert "FOLDER... A B" in result.output


def _replanned(row: EpisodeRow) -> EpisodeRow:
    """Return a real row as if plans had been made anew in it, with numbers that follow the seed."""
    number = row.seed - 79400
    return replace(
        row, success=row.success and number != 1, planning_time=2.0 * row.planning_time,
        replan_every=10, latency=2, replans=number, failed_replans=number // 2,
        replanning_time=0.1 * (number + 1) if number else 0.0,
    )  # fmt: skip


@pytest.fixture
def two_runs(tmp_path: Path) -> tuple[str, str]:
    write_folder(tmp_path / "once", TASKS[:2], ("smp",), 5)
    write_folder(tmp_path / "anew", TASKS[:2], ("smp", "cpromp"), 4, change=_replanned,
                 replan_every=10, latency=2)  # fmt: skip
    return str(tmp_path / "anew"), str(tmp_path / "once")


def test_one_method_in_two_runs_is_compared(two_runs: tuple[str, str]) -> None:
    result = CliRunner().invoke(app, ["compare", "--json", *two_runs, "smp"])
    assert result.exit_code == 0, result.output
    found = json.loads(result.output)
    assert found["settings"] == [
        "smp@anew plans anew every 10 steps at the latest, with a latency of 2.",
        "smp@once plans once.",
    ]
    assert found["cautions"] == [
        "Left out is what only one has played: 0 episodes of smp@anew, 2 of smp@once."
    ]
    placement, other, both = found["comparisons"]
    seeds = {str(79400 + number) for number in range(4)}
    expected = {t: [v for (_, s), v in _outcomes("smp", t).items() if s in seeds] for t in TASKS}
    for each, task in ((placement, TASKS[0]), (other, TASKS[1])):
        assert each["counts"]["second_only"] == expected[task][1]
        assert each["counts"]["both"] == sum(expected[task]) - expected[task][1]
    assert (both["first"], both["second"], both["counts"]["first_only"]) == (
        "smp@anew", "smp@once", 0,
    )  # fmt: skip
    # Every plan took twice as long: no spread.
    assert [both["times"]["solve_ratio"][name] for name in ("count", "value", "low", "high")] == [
        8, *[pytest.approx(2.0)] * 3,
    ]  # fmt: skip
    assert both["times"]["second_replans"] is both["times"]["replan_ratio"] is None
    replans = placement["times"]["first_replans"]
    assert (replans["replans"], replans["failed"]) == (1.5, pytest.approx(2 / 6))
    assert replans["median"] == pytest.approx(0.3)
    planning = [
        2 * float(row["planning_time"])
        for row in _table()
        if (row["task"], row["method"]) == (TASKS[0], "smp") and row["seed"] in seeds
    ]
    shares = [0.1 * (n + 1) / planning[n] for n in (1, 2, 3)]
    assert replans["of_first"]["value"] == pytest.approx(stats.gmean(shares))


def test_two_runs_are_shown_beside_each_other(
    two_runs: tuple[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "160")
    shown = CliRunner().invoke(app, ["compare", *two_runs, "smp"])
    assert shown.exit_code == 0
    for text in ("smp@anew", "plans made anew", "in vain", "smp@once plans once.", "2.00"):
        assert text in shown.output
    # Two methods of one run, both of which make plans anew, have a ratio of these, too.
    both = CliRunner().invoke(app, ["compare", "--json", two_runs[0], "smp", "cpromp"])
    ratio = json.loads(both.output)["comparisons"][-1]["times"]["replan_ratio"]
    assert (ratio["count"], ratio["value"]) == (6, pytest.approx(1.0))
    write_folder(tmp_path / "again", TASKS[:2], ("smp",), 5)
    again = CliRunner().invoke(app, ["compare", two_runs[1], str(tmp_path / "again"), "smp"])
    assert "plans made anew" not in again.output
    assert "plans once" not in again.output


@pytest.mark.parametrize(
    ("last", "message"),
    [
        (("nowhere", "smp"), "'nowhere' is neither a folder nor a method of .*which has: smp"),
        (("{other}", "spm"), "no rows of the method 'spm@anew'"),
        (("{late}", "smp"), "no episode in common: .*79400–79403.* the second .*79404–79405"),
        (("{drawn}", "smp"), "episode 79400 of Placement_hard is one scene in 'anew' and another"),
        (("{anew}", "smp"), "each folder once"),
        (("{other}", "{late}", "smp"), "in two runs, got 3 folders and 'smp'"),
    ],
)
def test_runs_that_cannot_be_compared_are_named(
    tmp_path: Path, last: tuple[str, ...], message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def drawn(version: int) -> Callable[[EpisodeRow], EpisodeRow]:
        return lambda row: replace(row, scene=f'{{"seed": {row.seed}, "version": {version}}}')

    def late(row: EpisodeRow) -> EpisodeRow:
        return replace(row, seed=row.seed + 4)

    write_folder(tmp_path / "anew", TASKS[:1], ("smp",), 4, change=drawn(1))
    write_folder(tmp_path / "drawn", TASKS[:1], ("smp",), 4, change=drawn(2))
    write_folder(tmp_path / "other", TASKS[:1], ("smp",), 4)
    write_folder(tmp_path / "late", TASKS[:1], ("smp",), 2, change=late, seed=79404)
    folders = {name: str(tmp_path / name) for name in ("anew", "other", "late", "drawn")}
    given = [folders["anew"], *(each.format(**folders) for each in last)]
    monkeypatch.setenv("COLUMNS", "400")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path)
        result = CliRunner().invoke(app, ["compare", *given])
    assert result.exit_code != 0
    assert re.search(message, result.output + str(result.exception), re.DOTALL)


def test_the_name_of_a_method_is_no_folder(
    hard: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_folder(tmp_path / "smp", TASKS[:1], ("smp",), 1)
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(app, ["compare", "--json", str(hard), "smp", "cpromp"])
    assert json.loads(result.output)["comparisons"][0]["first"] == "smp"
