"""Tables of the suite standard: success by task and method, by cell, and in pairs of methods."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from smp_gym.scene import DIFFICULTIES, TASKS
from smp_planner.benchmark.statistics import PairedCounts, mcnemar, rate_interval

__all__ = ["cell_table", "equal_episodes", "method_table", "pair_table"]

Line = Mapping[str, str]
Episode = dict[str, Line]

_EPISODE = ("task", "difficulty", "half", "seed")
_LEAST_P = 1e-4
"""p-values below it are printed as such."""


def equal_episodes(lines: Sequence[Line]) -> list[Episode]:
    """Return the episodes that all methods have played, each its lines by method.

    Args:
        lines: of `smp_planner.experiments.shipped_rows.standard_rows`.

    Raises:
        ValueError: there is no such episode.
    """
    methods = {line["method"] for line in lines}
    episodes: dict[tuple[str, ...], Episode] = {}
    for line in lines:
        key = tuple(line[name] for name in _EPISODE)
        episodes.setdefault(key, {})[line["method"]] = line
    equal = [found for found in episodes.values() if set(found) == methods]
    if not equal:
        raise ValueError(f"methods must have an episode in common, {sorted(methods)} have none")
    return equal


def method_table(episodes: Sequence[Episode]) -> list[list[str]]:
    """Return success and share of good particles, in %, by method and task, the first row the head.

    Args:
        episodes: of `equal_episodes`.
    """
    tasks = _tasks([line for episode in episodes for line in episode.values()])
    methods = dict.fromkeys(method for episode in episodes for method in episode)
    table = [["success · good", *tasks]]
    for method in methods:
        own = [episode[method] for episode in episodes]
        cells = [_rates([line for line in own if line["task"] == task]) for task in tasks]
        table.append([f"`{method}`", *cells])
    return table


def cell_table(lines: Sequence[Line], method: str) -> list[list[str]]:
    """Return the same of one method by task and difficulty.

    Args:
        lines: of `smp_planner.experiments.shipped_rows.standard_rows`.
        method: of some of them.
    """
    difficulties = [name for name in DIFFICULTIES if name != "none"]
    own = [line for line in lines if line["method"] == method]
    table = [["success · good", *difficulties]]
    for task in _tasks(own):
        cells = [
            [line for line in own if (line["task"], line["difficulty"]) == (task, difficulty)]
            for difficulty in difficulties
        ]
        table.append([task, *map(_rates, cells)])
    return table


def pair_table(episodes: Sequence[Episode], method: str) -> list[list[str]]:
    """Return episodes that a method alone solves and that a rival alone does, by rival and task.

    The last column is the p-value of McNemar's exact test on all episodes.

    Args:
        episodes: of `equal_episodes`.
        method: stands first in each pair.
    """
    rivals = [name for name in episodes[0] if name != method]
    tasks = _tasks([episode[method] for episode in episodes])
    of_tasks = [[each for each in episodes if each[method]["task"] == task] for task in tasks]
    groups = [*of_tasks, episodes]
    table = [["", *tasks, "all", "p"]]
    for rival in rivals:
        counts = [
            PairedCounts.of(
                *([episode[name]["success"] == "1" for episode in own] for name in (method, rival))
            )
            for own in groups
        ]
        alone = [f"{each.first_only} : {each.second_only}" for each in counts]
        p_value = mcnemar(counts[-1])
        text = f"< {_LEAST_P:.4f}" if p_value < _LEAST_P else f"{p_value:.2g}"
        table.append([f"`{rival}`", *alone, text])
    return table


def _tasks(lines: Sequence[Line]) -> list[str]:
    """Return the tasks of lines, in their usual order."""
    played = {line["task"] for line in lines}
    return [task for task in TASKS if task in played]


def _rates(lines: Sequence[Line]) -> str:
    """Return the rate of success with its interval, and the mean share of good particles.

    A dash stands for no lines, and for the share of what has no particles.
    """
    if not lines:
        return "–"
    rate = rate_interval(sum(line["success"] == "1" for line in lines), len(lines))
    value, low, high = (round(100 * rate[name]) for name in ("value", "low", "high"))
    shares = [float(line["share_good"]) for line in lines if line["share_good"]]
    good = f"{100 * sum(shares) / len(shares):.0f}" if shares else "–"
    return f"{value} ({low}–{high}) · {good}"
