"""The leaderboard: counted from its episodes, entered from runs, and some of it played again."""

import gzip
from collections import Counter, defaultdict
from dataclasses import replace
from pathlib import Path

import pytest
from fake_episodes import MEDIUM, fake_play
from real_rows import EPISODES as PLAYED
from real_rows import METHODS, TASKS, write_folder
from scipy.stats import binomtest

from smp_gym.suites import SUITES, home_suite
from smp_planner.benchmark.episodes import PlayMethods
from smp_planner.benchmark.leaderboard import (
    EPISODES,
    FROZEN,
    LEADERBOARD,
    LeaderboardEpisode,
    add_results,
    leaderboard_folder,
    read_episodes,
    read_leaderboard,
)
from smp_planner.benchmark.manifest import EpisodeStore, make_manifest
from smp_planner.benchmark.methods import known_methods_and_agents
from smp_planner.benchmark.results_folder import ResultsError

COMMAND = "python scripts/leaderboard.py FOLDER enters what `smp-bench run` has left in FOLDER"
REPLAYED = 3
SETTLED = ("promp", "random")
"""Methods that make no search of which the last bits, which differ between machines and versions,
decide how long an episode takes."""


def _quickest() -> list[LeaderboardEpisode]:
    """Return the quickest failure that is settled, and the quickest episodes of other entries."""
    known = set(known_methods_and_agents())
    episodes = sorted(
        (episode for episode in read_episodes(leaderboard_folder()) if episode.method in known),
        key=lambda episode: episode.planning_time + 0.01 * episode.steps,
    )
    failures = [e for e in episodes if not e.success and e.method in SETTLED][:1]
    chosen = {episode.entry: episode for episode in failures}
    for episode in episodes:
        if episode.success and len(chosen) < REPLAYED:
            chosen.setdefault(episode.entry, episode)
    return list(chosen.values())


@pytest.mark.parametrize("episode", _quickest(), ids=lambda e: f"{e.method}-{e.task}-{e.seed}")
def test_episodes_go_as_the_leaderboard_says(episode: LeaderboardEpisode) -> None:
    player = PlayMethods(replan_every=episode.replan_every or None)
    if episode.replan_every:
        player = replace(player, latency=episode.latency)
    row = player(episode.key)
    assert (int(row.success), row.cause) == (episode.success, episode.cause), COMMAND
    if row.method in SETTLED:
        assert row.steps == episode.steps


def test_the_leaderboard_is_counted_from_its_episodes() -> None:
    episodes = read_episodes(leaderboard_folder())
    played, solved = Counter(), Counter()
    times = defaultdict(list)
    for episode in episodes:
        played[episode.entry] += 1
        solved[episode.entry] += episode.success
        times[episode.entry].append(episode.planning_time)
        assert episode.suite == (home_suite(episode.key.cell) or "-")
        assert episode.suite in {*SUITES, "-"}
        assert bool(episode.half) == (episode.scenes == FROZEN)
        if episode.scenes != FROZEN:
            first, last = map(int, episode.scenes.split("-"))
            assert first <= episode.seed <= last
    lines = read_leaderboard(leaderboard_folder())
    assert len(lines) == len(played) > 0
    for line in lines:
        (entry,) = (
            entry
            for entry in played
            if entry
            == (
                line.suite,
                line.task,
                line.difficulty,
                line.family,
                line.sensing,
                line.noise,
                line.method,
                line.replan_every,
                line.latency,
                line.scenes,
            )
        )
        assert (line.n, line.successes) == (played[entry], solved[entry]), COMMAND
        wilson = binomtest(line.successes, line.n).proportion_ci(0.95, "wilson")
        assert (line.low, line.high) == pytest.approx((wilson.low, wilson.high), abs=5.1e-5)
        assert line.rate == pytest.approx(line.successes / line.n, abs=5.1e-5)
        below = sum(time <= line.planning_time + 1e-4 for time in times[entry])
        above = sum(time >= line.planning_time - 1e-4 for time in times[entry])
        assert min(below, above) >= line.n / 2
        if line.scenes != FROZEN:
            first, last = map(int, line.scenes.split("-"))
            assert line.n == last - first + 1


def test_a_run_is_entered_once_and_replaces_itself(tmp_path: Path) -> None:
    rows = write_folder(tmp_path / "run")
    lines = add_results([tmp_path / "run"], tmp_path / "board")
    assert len(lines) == len(TASKS) * len(METHODS)
    for line in lines:
        of_line = [r for r in rows if (r.task, r.method) == (line.task, line.method)]
        assert (line.n, line.successes) == (PLAYED, sum(r.success for r in of_line))
    assert read_leaderboard(tmp_path / "board") == lines
    before = [(tmp_path / "board" / name).read_bytes() for name in (LEADERBOARD, EPISODES)]
    add_results([tmp_path / "run"], tmp_path / "board")
    assert before == [(tmp_path / "board" / name).read_bytes() for name in (LEADERBOARD, EPISODES)]

    write_folder(
        tmp_path / "better",
        change=lambda row: replace(row, success=True, cause=""),
        methods=("cpromp",),
    )
    better = add_results([tmp_path / "better"], tmp_path / "board")
    assert len(better) == len(lines)
    assert {line.successes for line in better if line.method == "cpromp"} == {PLAYED}
    others = [line for line in lines if line.method != "cpromp"]
    assert sorted(map(str, others)) == sorted(
        str(line) for line in better if line.method != "cpromp"
    )


def test_frozen_episodes_are_entered_as_such(tmp_path: Path) -> None:
    manifest = make_manifest([MEDIUM], ["smp"], 0, 4, frozen=True)
    with EpisodeStore(tmp_path / "run", manifest) as store:
        for key in manifest.episode_keys():
            store.append(fake_play(key))
    (line,) = add_results([tmp_path / "run"], tmp_path / "board")
    assert (line.suite, line.scenes, line.n) == ("standard", FROZEN, 4)
    kept = [(episode.half, episode.seed) for episode in read_episodes(tmp_path / "board")]
    assert kept == sorted((key.half, key.seed) for key in manifest.episode_keys())


def test_runs_that_are_not_whole_are_refused(tmp_path: Path) -> None:
    manifest = make_manifest([MEDIUM], ["smp"], 7, 3)
    with EpisodeStore(tmp_path / "run", manifest) as store:
        store.append(fake_play(manifest.episode_keys()[0]))
    with pytest.raises(ResultsError, match="holds 1 of 3 episodes"):
        add_results([tmp_path / "run"], tmp_path / "board")
    write_folder(tmp_path / "twice")
    with pytest.raises(ValueError, match="holds again what a folder before it holds"):
        add_results([tmp_path / "twice"] * 2, tmp_path / "board")
    with pytest.raises(ResultsError, match="holds no results"):
        add_results([tmp_path], tmp_path / "board")
    write_folder(tmp_path / "listed", lists="/elsewhere")
    with pytest.raises(ResultsError, match="on the lists of '/elsewhere'"):
        add_results([tmp_path / "listed"], tmp_path / "board")
    assert not (tmp_path / "board").exists()


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("method", "planner", "its columns must be suite, "),
        (",1,,", ",2,,", "line [0-9]+: success must be 0 or 1, got 2"),
        (",1,,", ",0,,", "line [0-9]+: cause must be given of failures only"),
        (",hard,", ",harder,", "line 2: unknown difficulty 'harder'"),
        (",79400,", ",many,", "line [0-9]+: invalid literal"),
        (",smp,", ",smp,,", "line [0-9]+: [0-9]+ fields needed, got"),
    ],
)
def test_damaged_files_are_named(old: str, new: str, message: str, tmp_path: Path) -> None:
    write_folder(tmp_path / "run", tasks=TASKS[:1])
    add_results([tmp_path / "run"], tmp_path)
    path = tmp_path / EPISODES
    text = gzip.decompress(path.read_bytes()).decode()
    header, lines = text.split("\n", 1)
    text = text.replace(old, new, 1) if old in header else f"{header}\n{lines.replace(old, new, 1)}"
    path.write_bytes(gzip.compress(text.encode()))
    with pytest.raises(ValueError, match=f"{path}.*{message}"):
        read_episodes(tmp_path)


def test_torn_files_are_named(tmp_path: Path) -> None:
    (tmp_path / EPISODES).write_bytes(b"\x1f\x8b\x08")
    with pytest.raises(ValueError, match="is not a file of episodes"):
        read_episodes(tmp_path)
    with pytest.raises(ValueError, match="is not a leaderboard"):
        read_leaderboard(tmp_path)
