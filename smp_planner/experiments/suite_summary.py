"""Tables of a suite: success by method, by cell and in pairs of methods, by task or by family."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from smp_gym.scene import DIFFICULTIES, FAMILIES, TASKS
from smp_planner.benchmark.statistics import PairedCounts, mcnemar, rate_interval

__all__ = ["cell_table", "equal_episodes", "method_table", "pair_table"]

Line = Mapping[str, str]
Episode = dict[str, Line]

_EPISODE = ("task", "family", "difficulty", "half", "seed")
_GROUPS = {"task": TASKS, "family": FAMILIES}
"""Names by which episodes can be grouped, in the order of a table's columns or lines."""
_LEAST_P = 1e-4
"""p-values below it are printed as such."""


def equal_episodes(lines: Sequence[Line]) -> list[Episode]:
    """Return the episodes that all methods have played, each its lines by method.

    Args:
        lines: of `smp_planner.experiments.shipped_rows.suite_rows`.

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


def method_table(episodes: Sequence[Episode], by: str = "task") -> list[list[str]]:
    """Return success and share of good particles, in %, by method and task, the first row the head.

    Args:
        episodes: of `equal_episodes`.
        by: "task", or "family" for a column for each family.
    """
    groups = _groups([line for episode in episodes for line in episode.values()], by)
    methods = dict.fromkeys(method for episode in episodes for method in episode)
    table = [["success · good", *groups]]
    for method in methods:
        own = [episode[method] for episode in episodes]
        cells = [_rates([line for line in own if line[by] == group]) for group in groups]
        table.append([f"`{method}`", *cells])
    return table


def cell_table(lines: Sequence[Line], method: str, by: str = "task") -> list[list[str]]:
    """Return the same of one method by task, or family, and difficulty.

    Args:
        lines: of `smp_planner.experiments.shipped_rows.suite_rows`.
        method: of some of them.
        by: "task", or "family" for a line for each family.
    """
    difficulties = [name for name in DIFFICULTIES if name != "none"]
    own = [line for line in lines if line["method"] == method]
    table = [["success · good", *difficulties]]
    for group in _groups(own, by):
        cells = [
            [line for line in own if (line[by], line["difficulty"]) == (group, difficulty)]
            for difficulty in difficulties
        ]
        table.append([group, *map(_rates, cells)])
    return table


def pair_table(episodes: Sequence[Episode], method: str, by: str = "task") -> list[list[str]]:
    """Return episodes that a method alone solves and that a rival alone does, by rival and task.

    The last column is the p-value of McNemar's exact test on all episodes.

    Args:
        episodes: of `equal_episodes`.
        method: stands first in each pair.
        by: "task", or "family" for a column for each family.
    """
    rivals = [name for name in episodes[0] if name != method]
    names = _groups([episode[method] for episode in episodes], by)
    groups = [[each for each in episodes if each[method][by] == name] for name in names]
    groups.append(list(episodes))
    table = [["", *names, "all", "p"]]
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


def _groups(lines: Sequence[Line], by: str) -> list[str]:
    """Return the tasks, or families, of lines, in their usual order."""
    played = {line[by] for line in lines}
    return [name for name in _GROUPS[by] if name in played]


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
