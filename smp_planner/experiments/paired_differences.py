"""Differences between methods, paired over scenes, with intervals and corrected tests."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from smp_planner.benchmark.statistics import holm, mean_interval
from smp_planner.experiments.tables import Row

__all__ = ["Difference", "differences", "differences_table"]


@dataclass(frozen=True)
class Difference:
    """Mean over scenes of a measure of one method, less that of another.

    Attributes:
        task: of the scenes.
        method: whose measure is taken.
        measure: its name.
        scenes: in which both have it.
        mean: of the differences.
        low: lower end of the bootstrap interval over scenes, see `statistics.mean_interval`.
        high: upper end.
        p_value: of Wilcoxon's signed-rank test.
        corrected: the same, corrected by Holm's method for all methods and tasks of the measure.
    """

    task: str
    method: str
    measure: str
    scenes: int
    mean: float
    low: float
    high: float
    p_value: float
    corrected: float


def differences(rows: Sequence[Row], reference: str, measures: Sequence[str]) -> list[Difference]:
    """Return how all other methods differ from one, task by task.

    Args:
        rows: of scenes: ``task``, ``method``, ``seed`` and measures, None where there is none.
        reference: method whose measures are taken away.
        measures: names of columns.
    """
    values = {
        (str(row["task"]), str(row["method"]), row["seed"], name): row[name]
        for row in rows
        for name in measures
    }
    cells = dict.fromkeys((str(row["task"]), str(row["method"])) for row in rows)
    found = []
    for name in measures:
        pairs = {}
        for task, method in cells:
            if method == reference:
                continue
            seeds = [row["seed"] for row in rows if (row["task"], row["method"]) == (task, method)]
            both = [
                (values[task, method, seed, name], values.get((task, reference, seed, name)))
                for seed in seeds
            ]
            known = [float(a) - float(b) for a, b in both if a is not None and b is not None]
            if known:
                pairs[task, method] = known
        p_values = [_p_value(known) for known in pairs.values()]
        for ((task, method), known), p, corrected in zip(
            pairs.items(), p_values, holm(p_values), strict=True
        ):
            mean = mean_interval(known)
            found.append(
                Difference(
                    task,
                    method,
                    name,
                    len(known),
                    mean["value"],
                    mean["low"],
                    mean["high"],
                    p,
                    corrected,
                )
            )
    return found


def _p_value(known: Sequence[float]) -> float:
    if not np.any(known):
        return 1.0
    return float(stats.wilcoxon(known, zero_method="zsplit").pvalue)


def differences_table(found: Sequence[Difference]) -> list[list[str]]:
    """Return rows of a table, the first of them the head."""
    rows = [["task", "method", "measure", "scenes", "difference (95 %)", "p, corrected"]]
    for each in found:
        interval = f"{each.mean:+.3g} ({each.low:+.3g} to {each.high:+.3g})"
        shown = "< 0.001" if each.corrected < 1e-3 else f"{each.corrected:.3f}"
        rows.append([each.task, each.method, each.measure, str(each.scenes), interval, shown])
    return rows
