"""Two methods compared on equal episodes: success with a verdict, solve time, motion time."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from smp_gym.suites import Cell
from smp_planner.benchmark.episodes import EpisodeRow
from smp_planner.benchmark.joined_results import (
    Episode,
    JoinedResults,
    motion_time,
    suite_of,
)
from smp_planner.benchmark.results_folder import ResultsError
from smp_planner.benchmark.statistics import (
    CONFIDENCE,
    Estimate,
    PairedCounts,
    holm,
    mcnemar,
    mean_interval,
    paired_difference,
    rate_interval,
    ratio_interval,
)

__all__ = [
    "BETTER",
    "CANNOT_TELL",
    "LEVELS",
    "WORSE",
    "Comparison",
    "MotionTimes",
    "ReplanTimes",
    "SolveTimes",
    "Times",
    "compare_methods",
    "compare_pairs",
]

BETTER, WORSE, CANNOT_TELL = "better", "worse", "cannot tell"
"""Verdicts on the first of two methods."""

LEVELS = ("cell", "task", "difficulty", "suite", "all")
"""Levels at which episodes are pooled."""

ALL = "all episodes"


@dataclass(frozen=True)
class SolveTimes:
    """Times of planning, s, of all episodes, failures too.

    Attributes:
        median: of them.
        p75: 75th percentile.
        p98: 98th percentile; of fewer than 50 episodes nearly the longest.
    """

    median: float
    p75: float
    p98: float

    @classmethod
    def of(cls, rows: Sequence[EpisodeRow]) -> SolveTimes:
        """Return the percentiles of rows, at least one."""
        return cls(*_percentiles([row.planning_time for row in rows]))


def _percentiles(seconds: Sequence[float]) -> tuple[float, float, float]:
    median, p75, p98 = map(float, np.percentile(seconds, [50, 75, 98]))
    return median, p75, p98


@dataclass(frozen=True)
class ReplanTimes:
    """Plans that a method made anew, and their times, s.

    Attributes:
        replans: median of how many there are in an episode.
        failed: share of all of them that held no good particle.
        median: of the times of one of them, which rows hold as the mean of an episode.
        p75: 75th percentile.
        p98: 98th percentile.
        of_first: time of one as a share of that of the first plan of its episode, geometric mean
            over the episodes; None where the first took none.
    """

    replans: float
    failed: float
    median: float
    p75: float
    p98: float
    of_first: Estimate | None

    @classmethod
    def of(cls, rows: Sequence[EpisodeRow]) -> ReplanTimes | None:
        """Return the times of rows; None if no plan was made anew."""
        replanned = [row for row in rows if row.replans]
        if not replanned:
            return None
        times = [row.replanning_time for row in replanned]
        return cls(
            float(np.median([row.replans for row in rows])),
            sum(row.failed_replans for row in rows) / sum(row.replans for row in rows),
            *_percentiles(times),
            _ratio([(row.replanning_time, row.planning_time) for row in replanned]),
        )


@dataclass(frozen=True)
class MotionTimes:
    """Times of motion, s, on the episodes that both methods solve.

    Attributes:
        first: mean of the first method.
        second: mean of the second.
        difference: mean of the first less the second, episode by episode.
    """

    first: float
    second: float
    difference: Estimate

    @classmethod
    def of(cls, pairs: Sequence[tuple[EpisodeRow, EpisodeRow]]) -> MotionTimes | None:
        """Return the times of pairs of rows; None if no episode is solved by both."""
        times = [
            (motion_time(one), motion_time(other))
            for one, other in pairs
            if one.success and other.success
        ]
        if not times:
            return None
        first, second = np.mean(times, axis=0)
        differences = [one - other for one, other in times]
        return cls(float(first), float(second), mean_interval(differences))


@dataclass(frozen=True)
class Times:
    """Times of two methods on the same episodes.

    Attributes:
        first_solve: times of planning of the first method.
        second_solve: of the second.
        motion: times of motion; None where no episode is solved by both.
        solve_ratio: time of planning of the first over that of the second, geometric mean over the
            episodes; None where one plans nothing.
        first_replans: plans that the first method made anew; None if it made none.
        second_replans: those of the second.
        replan_ratio: time of one plan made anew, as `solve_ratio`, over the episodes in which both
            made some; None if there is no such.
    """

    first_solve: SolveTimes
    second_solve: SolveTimes
    motion: MotionTimes | None
    solve_ratio: Estimate | None = None
    first_replans: ReplanTimes | None = None
    second_replans: ReplanTimes | None = None
    replan_ratio: Estimate | None = None

    @classmethod
    def of(cls, pairs: Sequence[tuple[EpisodeRow, EpisodeRow]]) -> Times:
        """Return the times of pairs of rows, at least one."""
        first, second = zip(*pairs, strict=True)
        return cls(
            SolveTimes.of(first),
            SolveTimes.of(second),
            MotionTimes.of(pairs),
            _ratio([(one.planning_time, other.planning_time) for one, other in pairs]),
            ReplanTimes.of(first),
            ReplanTimes.of(second),
            _ratio([(one.replanning_time, other.replanning_time) for one, other in pairs]),
        )


def _ratio(times: Sequence[tuple[float, float]]) -> Estimate | None:
    """Return the ratio of pairs of times, s, of which both are there: what was not done took 0."""
    done = [pair for pair in times if min(pair) > 0.0]
    return ratio_interval(*zip(*done, strict=True)) if done else None


@dataclass(frozen=True)
class Comparison:
    """Two methods on the same episodes.

    Attributes:
        level: one of `LEVELS`.
        name: of the cell, task, difficulty or suite.
        first: name of the first method.
        second: name of the second.
        counts: outcomes in pairs.
        first_rate: success of the first, with its interval.
        second_rate: success of the second.
        difference: the first rate less the second, with its interval for pairs.
        p_value: of the exact test that both succeed equally often.
        corrected: the same, corrected by Holm's method for all comparisons made together.
        verdict: on the first method; one of `BETTER`, `WORSE` and `CANNOT_TELL`, the last where
            the corrected p-value is not below 1 - `CONFIDENCE`.
        times: of both; None where only success is compared.
    """

    level: str
    name: str
    first: str
    second: str
    counts: PairedCounts
    first_rate: Estimate
    second_rate: Estimate
    difference: Estimate
    p_value: float
    corrected: float
    verdict: str
    times: Times | None = None


def _compare(
    results: JoinedResults,
    first: str,
    second: str,
    episodes: Sequence[Episode],
    level: str,
    name: str,
    timed: bool = False,
) -> Comparison:
    """Return the comparison on some episodes, not corrected and without a verdict yet."""
    pairs = [(results.rows[first][e], results.rows[second][e]) for e in episodes]
    counts = PairedCounts.of([a.success for a, _ in pairs], [b.success for _, b in pairs])
    p_value = mcnemar(counts)
    return Comparison(
        level,
        name,
        first,
        second,
        counts,
        rate_interval(counts.of_first, counts.count),
        rate_interval(counts.of_second, counts.count),
        paired_difference(counts),
        p_value,
        p_value,
        CANNOT_TELL,
        Times.of(pairs) if timed else None,
    )


def _judged(comparisons: Sequence[Comparison]) -> list[Comparison]:
    """Return comparisons that are made together, corrected and with their verdicts."""
    corrected = holm([each.p_value for each in comparisons])
    judged = []
    for each, p_value in zip(comparisons, corrected, strict=True):
        verdict = CANNOT_TELL
        if p_value < 1.0 - CONFIDENCE:
            verdict = BETTER if each.difference["value"] > 0 else WORSE
        judged.append(replace(each, corrected=p_value, verdict=verdict))
    return judged


_NAMES: dict[str, Callable[[Cell], str]] = {
    "cell": lambda cell: cell.name,
    "task": lambda cell: cell.task,
    "difficulty": lambda cell: cell.difficulty,
    "suite": suite_of,
    "all": lambda cell: ALL,
}


def _groups(level: str, episodes: Sequence[Episode]) -> Iterator[tuple[str, list[Episode]]]:
    """Yield what a level takes together, by name."""
    groups: dict[str, list[Episode]] = {}
    for episode in episodes:
        groups.setdefault(_NAMES[level](episode.cell), []).append(episode)
    yield from groups.items()


def compare_methods(results: JoinedResults, first: str, second: str) -> list[Comparison]:
    """Return the comparisons of two methods on the episodes that both have played.

    There is one for each cell, task, difficulty and suite, and one of all. Those of a level are
    corrected together; a level that says what another has said already is left out.

    Args:
        results: of both.
        first: name of a method in them.
        second: name of another.

    Raises:
        ResultsError: a name is not there, both are the same, or they have no episode in common.
    """
    for name in (first, second):
        if name not in results.methods:
            raise ResultsError(
                f"no rows of the method {name!r}; there are: {', '.join(results.methods)}"
            )
    if first == second:
        raise ResultsError(f"two methods are compared, got {first!r} twice")
    episodes = results.common((first, second))
    if not episodes:
        raise ResultsError(
            f"{first!r} and {second!r} have played no episode in common: the first "
            f"{_played(results, first)}; the second {_played(results, second)}"
        )
    comparisons: list[Comparison] = []
    partitions: list[set[frozenset[Episode]]] = []
    for level in LEVELS:
        groups = dict(_groups(level, episodes))
        partition = {frozenset(group) for group in groups.values()}
        if partition not in partitions:
            partitions.append(partition)
            comparisons += _judged(
                [
                    _compare(results, first, second, group, level, name, timed=True)
                    for name, group in groups.items()
                ]
            )
    return comparisons


def _played(results: JoinedResults, method: str) -> str:
    """Return what a method has played, in words."""
    seeds: dict[str, list[int]] = {}
    for episode in results.rows[method]:
        half = f" ({episode.half})" if episode.half else ""
        seeds.setdefault(f"{episode.cell.name}{half}", []).append(episode.seed)
    return ", ".join(f"{name} {min(own)}–{max(own)}" for name, own in seeds.items())


def compare_pairs(
    results: JoinedResults, methods: Sequence[str], episodes: Sequence[Episode], level: str = "all"
) -> list[Comparison]:
    """Return the success of all pairs of methods on some episodes, corrected together.

    Args:
        results: of the methods.
        methods: in each pair, the one that is earlier here is the first.
        episodes: that all of them have played, at least one.
        level: one of `LEVELS`; each of its groups is compared.
    """
    return _judged(
        [
            _compare(results, first, second, group, level, name)
            for name, group in _groups(level, episodes)
            for number, first in enumerate(methods)
            for second in methods[number + 1 :]
        ]
    )
