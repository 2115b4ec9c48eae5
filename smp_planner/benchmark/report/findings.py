"""Numbers of a report: of methods, cells, pairs of methods, times and failures."""

from __future__ import annotations

import re
import shlex
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from smp_gym.arrays import FloatArray
from smp_gym.observation import SENSINGS
from smp_gym.scene import DIFFICULTIES, FAMILIES
from smp_gym.suites import Cell
from smp_planner.benchmark.aggregates import (
    improvement_probability,
    interquartile_mean,
    performance_profile,
)
from smp_planner.benchmark.episodes import EpisodeRow, contact_in_words
from smp_planner.benchmark.joined_results import (
    Episode,
    JoinedResults,
    Source,
    completion_time,
    motion_time,
    suite_of,
)
from smp_planner.benchmark.paired_comparison import (
    Comparison,
    SolveTimes,
    compare_pairs,
)
from smp_planner.benchmark.report.trainings import Trainings, trainings
from smp_planner.benchmark.results_folder import ResultsError
from smp_planner.benchmark.statistics import Estimate, mean_interval, rate_interval

__all__ = [
    "CellFindings",
    "CellRate",
    "Failure",
    "Findings",
    "LevelRates",
    "MethodFindings",
    "Pair",
    "Profiles",
    "cell_title",
    "find",
    "replay_command",
]

_PROFILE_POINTS = 161


@dataclass(frozen=True)
class MethodFindings:
    """One method on the episodes that all methods have played.

    Attributes:
        name: of the method.
        number: from 0, by which colour and mark are chosen; of the method that is named first.
        successes: of the episodes.
        success: their rate.
        collision: rate of episodes that a collision ended.
        good: mean share of the trajectories of a plan that meet all constraints; None of a method
            that proposes none.
        solve: times of planning.
        motion: mean time of motion of its successes, s; None without any.
        completion: interquartile mean of the time of planning and motion, s, infinite if a quarter
            or more of the episodes failed, since failures never complete.
        causes: how often each cause ended an episode.
        contacts: how often each pair of parts was the forbidden contact.
    """

    name: str
    number: int
    successes: int
    success: Estimate
    collision: Estimate
    good: Estimate | None
    solve: SolveTimes
    motion: Estimate | None
    completion: Estimate
    causes: Mapping[str, int]
    contacts: Mapping[str, int]


@dataclass(frozen=True)
class CellRate:
    """Success of a method on a cell.

    Attributes:
        method: its name.
        number: see `MethodFindings`.
        successes: of the episodes.
        success: their rate.
    """

    method: str
    number: int
    successes: int
    success: Estimate


@dataclass(frozen=True)
class CellFindings:
    """Success on a cell, over the episodes that all methods with rows there have played.

    Attributes:
        cell: see `smp_gym.suites.Cell`.
        suite: that it is of.
        episodes: how many.
        rates: of the methods.
    """

    cell: Cell
    suite: str
    episodes: int
    rates: tuple[CellRate, ...]


@dataclass(frozen=True)
class LevelRates:
    """Success by difficulty in a suite, tasks and families taken together.

    Attributes:
        suite: its name.
        difficulties: of its cells, the easiest first.
        episodes: of each difficulty, of each method.
        rates: by method, of each difficulty; None where the method has not played there.
    """

    suite: str
    difficulties: tuple[str, ...]
    episodes: tuple[int, ...]
    rates: Mapping[str, tuple[Estimate | None, ...]]


@dataclass(frozen=True)
class Pair:
    """Two methods on the episodes that all have played.

    Attributes:
        comparison: of their success.
        sooner: probability that the first completes an episode before the second does; failures
            never do, and ties count half.
    """

    comparison: Comparison
    sooner: Estimate


@dataclass(frozen=True)
class Profiles:
    """Shares of episodes completed by a time, cells counting equally.

    Attributes:
        times: (K,) s, of planning and motion together.
        shares: by method, of `performance_profile`.
    """

    times: FloatArray
    shares: Mapping[str, Mapping[str, FloatArray]]


@dataclass(frozen=True)
class Failure:
    """An episode that a method failed.

    Attributes:
        row: of the episode.
        cell: in words.
        cause: of the failure.
        contact: the pair of parts that touched, in words; empty if none did.
        time: of the end, s after the first action.
        command: that plays it again.
    """

    row: EpisodeRow
    cell: str
    cause: str
    contact: str
    time: float
    command: str


@dataclass(frozen=True)
class Findings:
    """All that a report says.

    Attributes:
        sources: the folders.
        cautions: see `JoinedResults.cautions`.
        episodes: that all methods have played; empty where there are none.
        methods: by successes, the most first.
        cells: of all folders.
        levels: a chart each.
        pairs: of all methods, the one of more successes first; empty without common episodes.
        where: the best method against each other one, task by task, corrected together.
        trainings: of agents of which several are among the methods.
        profiles: None without common episodes.
        failures: by method, of all its rows.
        played: number of rows of each method.
    """

    sources: tuple[Source, ...]
    cautions: tuple[str, ...]
    episodes: tuple[Episode, ...]
    methods: tuple[MethodFindings, ...]
    cells: tuple[CellFindings, ...]
    levels: tuple[LevelRates, ...]
    pairs: tuple[Pair, ...]
    where: tuple[Comparison, ...]
    trainings: tuple[Trainings, ...]
    profiles: Profiles | None
    failures: Mapping[str, tuple[Failure, ...]]
    played: Mapping[str, int]


def find(results: JoinedResults, methods: Sequence[str] = ()) -> Findings:
    """Return the findings of results.

    Args:
        results: of the folders.
        methods: names of those that the report is of; none for all.

    Raises:
        ResultsError: a name is not among the methods.
    """
    names = list(methods) or list(results.methods)
    for name in names:
        if name not in results.methods:
            raise ResultsError(
                f"no rows of the method {name!r}; there are: {', '.join(results.methods)}"
            )
    names = list(dict.fromkeys(names))
    common = results.common(names)
    found = [_method(results, name, number, common) for number, name in enumerate(names)]
    found.sort(key=lambda method: -method.success["value"])
    order = [method.name for method in found]
    numbers = {method.name: method.number for method in found}
    return Findings(
        results.sources,
        tuple(results.cautions()),
        tuple(common),
        tuple(found),
        tuple(_cells(results, order, numbers)),
        tuple(_levels(results, order)),
        tuple(_pairs(results, order, common)) if common else (),
        tuple(_where(results, order, common)) if common else (),
        tuple(trainings(results, order, common)) if common else (),
        _profiles(results, order, common) if common else None,
        {name: tuple(_failures(results, name)) for name in order},
        {name: len(results.rows[name]) for name in order},
    )


def _rows(results: JoinedResults, method: str, episodes: Sequence[Episode]) -> list[EpisodeRow]:
    rows = results.rows[method]
    return [rows[episode] for episode in episodes or rows]


def _method(
    results: JoinedResults, name: str, number: int, episodes: Sequence[Episode]
) -> MethodFindings:
    rows = _rows(results, name, episodes)
    successes = sum(row.success for row in rows)
    motions = [motion_time(row) for row in rows if row.success]
    shares = [row.share_good for row in rows if row.share_good is not None]
    return MethodFindings(
        name,
        number,
        successes,
        rate_interval(successes, len(rows)),
        rate_interval(sum(row.collision for row in rows), len(rows)),
        mean_interval(shares) if shares else None,
        SolveTimes.of(rows),
        mean_interval(motions) if motions else None,
        _completion(results, name, episodes or list(results.rows[name])),
        dict(Counter(row.cause for row in rows if not row.success).most_common()),
        dict(Counter(_kinds_of_contact(row.contact) for row in rows if row.contact).most_common()),
    )


def _completion(results: JoinedResults, name: str, episodes: Sequence[Episode]) -> Estimate:
    """Return the interquartile mean of the time to completion of a method, s."""
    scores = interquartile_mean(_by_cell(results, name, episodes))
    return {
        "count": scores["count"],
        "value": -scores["value"],
        "low": -scores["high"],
        "high": -scores["low"],
    }


def _cells(
    results: JoinedResults, order: Sequence[str], numbers: Mapping[str, int]
) -> list[CellFindings]:
    found = []
    for cell in results.cells:
        playing = [m for m in order if any(e.cell == cell for e in results.rows[m])]
        episodes = [e for e in results.common(playing) if e.cell == cell] if playing else []
        if not episodes:
            continue
        rates = []
        for method in playing:
            successes = sum(results.rows[method][e].success for e in episodes)
            rate = rate_interval(successes, len(episodes))
            rates.append(CellRate(method, numbers[method], successes, rate))
        found.append(CellFindings(cell, suite_of(cell), len(episodes), tuple(rates)))
    return found


def _levels(results: JoinedResults, order: Sequence[str]) -> list[LevelRates]:
    found = []
    for suite in dict.fromkeys(suite_of(cell) for cell in results.cells):
        cells = [cell for cell in results.cells if suite_of(cell) == suite]
        difficulties = [d for d in DIFFICULTIES if any(c.difficulty == d for c in cells)]
        rates: dict[str, list[Estimate | None]] = {method: [] for method in order}
        counts = []
        for difficulty in difficulties:
            group = {cell for cell in cells if cell.difficulty == difficulty}
            playing = [m for m in order if any(e.cell in group for e in results.rows[m])]
            episodes = [e for e in results.common(playing) if e.cell in group] if playing else []
            counts.append(len(episodes))
            for method in order:
                if method in playing and episodes:
                    successes = sum(results.rows[method][e].success for e in episodes)
                    rates[method].append(rate_interval(successes, len(episodes)))
                else:
                    rates[method].append(None)
        if any(counts):
            by_method = {method: tuple(values) for method, values in rates.items()}
            found.append(LevelRates(suite, tuple(difficulties), tuple(counts), by_method))
    return found


def _by_cell(
    results: JoinedResults, method: str, episodes: Sequence[Episode]
) -> dict[str, list[float]]:
    """Return the scores of a method by cell: the time to completion, negative."""
    return {
        cell.name: [-completion_time(results.rows[method][e]) for e in group]
        for cell, group in groupby(episodes, key=lambda episode: episode.cell)
    }


def _pairs(results: JoinedResults, order: Sequence[str], episodes: Sequence[Episode]) -> list[Pair]:
    scores = {method: _by_cell(results, method, episodes) for method in order}
    return [
        Pair(each, improvement_probability(scores[each.first], scores[each.second], paired=True))
        for each in compare_pairs(results, order, episodes)
    ]


def _where(
    results: JoinedResults, order: Sequence[str], episodes: Sequence[Episode]
) -> list[Comparison]:
    """Return the comparisons of the best method with each other one, task by task."""
    if len(order) < 2 or len({episode.cell.task for episode in episodes}) < 2:
        return []
    every = compare_pairs(results, order, episodes, "task")
    return [each for each in every if each.first == order[0]]


def _profiles(
    results: JoinedResults, order: Sequence[str], episodes: Sequence[Episode]
) -> Profiles | None:
    scores = {method: _by_cell(results, method, episodes) for method in order}
    together = -np.concatenate([np.concatenate(list(s.values())) for s in scores.values()])
    finite = together[np.isfinite(together)]
    if not len(finite):
        return None
    # A few episodes during which the machine stood still are no reason to show nothing else.
    last = float(np.percentile(finite, 99))
    times = np.linspace(0.0, last, _PROFILE_POINTS)
    return Profiles(times, {m: performance_profile(s, -times) for m, s in scores.items()})


def _failures(results: JoinedResults, method: str) -> list[Failure]:
    return [
        Failure(
            row,
            cell_title(episode.cell),
            row.cause or "unfinished",
            contact_in_words(row.contact),
            motion_time(row),
            replay_command(row, results.source(method, episode)),
        )
        for episode, row in results.rows[method].items()
        if not row.success
    ]


def _kinds_of_contact(contact: str) -> str:
    """Return a pair of parts with all obstacles as one, the arm's part first."""
    parts = [re.sub(r"^(obstacle) \d+$", r"\1", p) for p in contact_in_words(contact).split(" – ")]
    return " – ".join(sorted(parts, key=lambda part: part == "obstacle"))


def cell_title(cell: Cell) -> str:
    """Return a cell in words, such as "Placement, shelf, hard, noise 20 mm"."""
    words = [cell.task]
    if cell.family != FAMILIES[0]:
        words.append(cell.family)
    words.append("no obstacles" if cell.difficulty == "none" else cell.difficulty)
    if cell.sensing == "noise":
        words.append(f"noise {1000.0 * cell.noise:g} mm")
    elif cell.sensing != SENSINGS[0]:
        words.append(cell.sensing)
    return ", ".join(words)


def replay_command(row: EpisodeRow, source: Source) -> str:
    """Return the command that plays an episode again, and draws and films it."""
    options: list[tuple[str, object]] = [("task", row.task), ("difficulty", row.difficulty)]
    if row.family != FAMILIES[0]:
        options.append(("family", row.family))
    if row.sensing != SENSINGS[0]:
        options.append(("sensing", row.sensing))
    if row.noise:
        options.append(("noise", row.noise))
    options += [("method", source.manifest.specs.get(row.method, row.method)), ("seed", row.seed)]
    if row.half:
        options.append(("half", row.half))
        if source.manifest.lists:
            options.append(("lists", source.manifest.lists))
    if row.replan_every:
        options += [("replan-every", row.replan_every), ("latency", row.latency)]
    words = ["smp-bench", "draw"]
    for name, value in options:
        words += [f"--{name}", str(value)]
    return shlex.join([*words, "--out", "replay"])
