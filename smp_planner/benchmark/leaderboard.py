"""The leaderboard: what methods have achieved on the same episodes, and the episodes it rests on.

Two files stand in ``envs_assets/results``: ``episodes.csv.gz``, a line for each episode of each
method, and ``leaderboard.csv``, a line for each entry, counted from the first. An entry is a method
on a cell, on the frozen list or on a range of seeds.
"""

from __future__ import annotations

import csv
import gzip
import io
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, astuple, dataclass, fields
from itertools import groupby
from pathlib import Path
from statistics import median
from typing import Any, TypeVar

from smp_gym.assets import asset_path
from smp_gym.atomic_files import replacing
from smp_gym.suites import Cell, home_suite
from smp_gym.untrusted_files import LARGEST_TEXT, read_file, unzipped
from smp_planner.benchmark.episodes import EpisodeKey, EpisodeRow
from smp_planner.benchmark.manifest import Manifest, read_results
from smp_planner.benchmark.results_folder import ResultsError, write_table
from smp_planner.benchmark.statistics import rate_interval

__all__ = [
    "EPISODES",
    "FROZEN",
    "LEADERBOARD",
    "Entry",
    "LeaderboardEpisode",
    "add_results",
    "entries",
    "leaderboard_folder",
    "read_episodes",
    "read_leaderboard",
]

LEADERBOARD, EPISODES = "leaderboard.csv", "episodes.csv.gz"
"""Names of the files."""

FROZEN = "frozen list"
"""The `scenes` of an entry that was measured on the first episodes of a frozen list."""

_SINGLE = "-"
_DIGITS = 4


@dataclass(frozen=True)
class Measurement:
    """A method, and the scenes on which it is measured.

    Attributes:
        suite: whose frozen list holds the cell's scenes; "-" if none does.
        task: see `smp_gym.suites.Cell`, as the next four.
        difficulty: of the scene.
        family: of the scene.
        sensing: of the environment.
        noise: of the environment, m.
        method: name of the method.
        replan_every: control steps after which it plans anew; 0 if it plans once.
        latency: control steps from asking for a plan to its taking effect; 0 likewise.
        scenes: of the entry, `FROZEN` or the first and last seed, as in ``79800-79809``.
    """

    suite: str
    task: str
    difficulty: str
    family: str
    sensing: str
    noise: float
    method: str
    replan_every: int
    latency: int
    scenes: str


@dataclass(frozen=True, order=True)
class LeaderboardEpisode(Measurement):
    """One episode of a measurement.

    Attributes:
        half: of the frozen list; empty for a scene that is drawn from its seed.
        seed: of the scene.
        success: 1 if the physics engine judged the episode a success, else 0.
        cause: of the failure; empty after a success.
        steps: environment steps.
        planning_time: s, of the first plan.
        code: digest of the code that played it.
    """

    half: str
    seed: int
    success: int
    cause: str
    steps: int
    planning_time: float
    code: str

    def __post_init__(self) -> None:
        if self.success not in (0, 1):
            raise ValueError(f"success must be 0 or 1, got {self.success}")
        if bool(self.cause) == bool(self.success):
            raise ValueError(f"cause must be given of failures only, got {self.cause!r}")
        Cell(self.task, self.difficulty, self.family, self.sensing, self.noise)

    @property
    def key(self) -> EpisodeKey:
        """Identifier of the episode, by which it can be played again."""
        cell = Cell(self.task, self.difficulty, self.family, self.sensing, self.noise)
        return EpisodeKey.of(cell, self.method, self.seed, self.half)

    @property
    def entry(self) -> tuple[str | float, ...]:
        """The fields of the measurement, which the episodes of one entry have in common."""
        return tuple(getattr(self, name) for name in _COMMON)


_NAMES = [each.name for each in fields(LeaderboardEpisode)]
_COMMON = [each.name for each in fields(Measurement)]


@dataclass(frozen=True)
class Entry(Measurement):
    """One line of the leaderboard, what a measurement comes to.

    Attributes:
        n: episodes.
        successes: of them.
        rate: of success, rounded, as the next two.
        low: end of the 95 % Wilson interval of the rate.
        high: its other end.
        planning_time: s, median.
        code: digest of the code.
    """

    n: int
    successes: int
    rate: float
    low: float
    high: float
    planning_time: float
    code: str


_Line = TypeVar("_Line", LeaderboardEpisode, Entry)


def leaderboard_folder() -> Path:
    """Return the folder of the leaderboard that ships with the package."""
    return asset_path("results")


def _of_run(manifest: Manifest, rows: Sequence[EpisodeRow]) -> list[LeaderboardEpisode]:
    last = manifest.seed + manifest.episodes - 1
    scenes = FROZEN if manifest.frozen else f"{manifest.seed}-{last}"
    return [
        LeaderboardEpisode(
            home_suite(row.key.cell) or _SINGLE,
            row.task,
            row.difficulty,
            row.family,
            row.sensing,
            row.noise,
            row.method,
            row.replan_every,
            row.latency,
            scenes,
            row.half,
            row.seed,
            int(row.success),
            row.cause,
            row.steps,
            round(row.planning_time, _DIGITS),
            manifest.code,
        )
        for row in rows
    ]


def _check_run(folder: Path, manifest: Manifest, rows: Sequence[EpisodeRow]) -> None:
    """Raise ResultsError unless the rows of a run can stand in the leaderboard."""
    planned = len(manifest.episode_keys())
    if len(rows) < planned:
        raise ResultsError(
            f"{str(folder)!r} holds {len(rows)} of {planned} episodes; only whole runs are entered"
        )
    if manifest.lists:
        raise ResultsError(
            f"{str(folder)!r} was played on the lists of {manifest.lists!r}; allowed are the "
            "package's and seeds"
        )


def entries(episodes: Iterable[LeaderboardEpisode]) -> list[Entry]:
    """Return the lines of the leaderboard: within cell and scenes, the best method first."""
    counted = []
    for _, group in groupby(sorted(episodes), key=lambda episode: episode.entry):
        played = list(group)
        successes = sum(episode.success for episode in played)
        rate = rate_interval(successes, len(played))
        common: dict[str, Any] = {name: getattr(played[0], name) for name in _COMMON}
        counted.append(
            Entry(
                **common,
                n=len(played),
                successes=successes,
                rate=round(rate["value"], _DIGITS),
                low=round(rate["low"], _DIGITS),
                high=round(rate["high"], _DIGITS),
                planning_time=round(median(e.planning_time for e in played), _DIGITS),
                code=" ".join(sorted({episode.code for episode in played})),
            )
        )

    def place(entry: Entry) -> tuple[object, ...]:
        cell = (entry.suite, entry.task, entry.difficulty, entry.family, entry.sensing, entry.noise)
        return *cell, entry.scenes, -entry.rate, entry.planning_time, entry.method

    return sorted(counted, key=place)


def read_episodes(folder: Path) -> list[LeaderboardEpisode]:
    """Return the episodes of a leaderboard; none where there is no file of them.

    Raises:
        ValueError: the file is damaged; the message names it and the line.
    """
    path = folder / EPISODES
    if not path.exists():
        return []
    try:
        text = unzipped(read_file(path), "the file", LARGEST_TEXT).decode("utf-8")
    except (OSError, ValueError) as error:
        raise ValueError(f"{path} is not a file of episodes: {error}") from error
    episodes = _parsed(path, text, LeaderboardEpisode)
    keys = [(episode.entry, episode.key) for episode in episodes]
    if len(set(keys)) < len(keys):
        raise ValueError(f"{path} holds an episode twice")
    return episodes


def read_leaderboard(folder: Path) -> list[Entry]:
    """Return the lines of a leaderboard, as they stand in its file.

    Raises:
        ValueError: the file is damaged, or not there.
    """
    path = folder / LEADERBOARD
    try:
        text = read_file(path).decode("utf-8")
    except (OSError, ValueError) as error:
        raise ValueError(f"{path} is not a leaderboard: {error}") from error
    return _parsed(path, text, Entry)


def _parsed(path: Path, text: str, kind: type[_Line]) -> list[_Line]:
    """Return the lines of a CSV file as objects of a dataclass of texts and numbers."""
    names = [each.name for each in fields(kind)]
    kinds: dict[str, Callable[[str], Any]] = {"str": str, "int": int, "float": float}
    parse = [kinds[str(each.type)] for each in fields(kind)]
    header, *lines = list(csv.reader(io.StringIO(text))) or [[]]
    if header != names:
        raise ValueError(f"{path}: its columns must be {', '.join(names)}; got {', '.join(header)}")
    parsed = []
    for number, line in enumerate(lines, 2):
        try:
            if len(line) != len(names):
                raise ValueError(f"{len(names)} fields needed, got {len(line)}")
            parsed.append(kind(*(to(value) for to, value in zip(parse, line, strict=True))))
        except ValueError as error:
            raise ValueError(f"{path}, line {number}: {error}") from error
    return parsed


def add_results(folders: Sequence[Path], out: Path) -> list[Entry]:
    """Enter whole runs of the benchmark, and return the lines of the leaderboard.

    An entry that is there already, of the same method, cell and scenes, is replaced.

    Args:
        folders: of results.
        out: folder of the leaderboard; made if there is none.

    Raises:
        ResultsError: there are no results, or they are damaged, not finished or of other lists.
        ValueError: two folders hold the same entry, or the files in `out` are damaged.
    """
    new: dict[tuple[object, ...], list[LeaderboardEpisode]] = {}
    for folder in folders:
        manifest, rows = read_results(folder)
        _check_run(folder, manifest, rows)
        of_run = sorted(_of_run(manifest, rows))
        for common, group in groupby(of_run, key=lambda episode: episode.entry):
            if common in new:
                raise ValueError(f"{str(folder)!r} holds again what a folder before it holds")
            new[common] = list(group)
    kept = [episode for episode in read_episodes(out) if episode.entry not in new]
    episodes = sorted([*kept, *(episode for group in new.values() for episode in group)])
    out.mkdir(parents=True, exist_ok=True)
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(_NAMES)
    writer.writerows(astuple(episode) for episode in episodes)
    with replacing(out / EPISODES) as aside:
        aside.write_bytes(gzip.compress(text.getvalue().encode("utf-8"), mtime=0))
    lines = entries(episodes)
    write_table(
        out / LEADERBOARD,
        [each.name for each in fields(Entry)],
        (list(asdict(line).values()) for line in lines),
    )
    return lines
