"""Summary of particle sets, task by task: a line for each method, and how near draws would be."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from smp_planner.benchmark.statistics import Estimate, ratio_of_means
from smp_planner.experiments.tables import Row
from smp_planner.experiments.unselected_scenes import FLOOR

__all__ = ["SUMMARY", "ratio_table", "ratio_to_floor", "set_table"]

SUMMARY = (
    ("good", 0),
    ("success", 0),
    ("wasserstein", 0),
    ("coverage", 0),
    ("entropy", 1),
    ("demonstrations", 0),
)
"""Columns of a cell, and their digits after the decimal point."""


def set_table(rows: Sequence[Row], columns: Sequence[tuple[str, int]] = SUMMARY) -> list[list[str]]:
    """Return means over the scenes by method and task, the first row the head.

    Args:
        rows: of `unselected_scenes.measure_scene`.
        columns: of a cell, with their digits after the decimal point; a dash stands for no value.
    """
    tasks, methods = (dict.fromkeys(str(row[name]) for row in rows) for name in ("task", "method"))
    lines = [["", *tasks]]
    for method in methods:
        cells = []
        for task in tasks:
            own = [row for row in rows if (row["task"], row["method"]) == (task, method)]
            cells.append(" · ".join(_mean(own, *column) for column in columns))
        lines.append([method, *cells])
    return lines


def _mean(rows: Sequence[Row], name: str, digits: int) -> str:
    known = [float(row[name]) for row in rows if row[name] not in (None, "")]  # type: ignore[arg-type]
    return f"{np.mean(known):.{digits}f}" if known else "–"


def ratio_to_floor(rows: Sequence[Row], task: str, method: str) -> Estimate:
    """Return how many times the noise floor's distance to the posterior a method's is.

    It is the ratio of the means over the scenes in which both have a distance, with the interval of
    `smp_planner.benchmark.statistics.ratio_of_means`.

    Args:
        rows: of `unselected_scenes.measure_scene`.
        task: of the scenes.
        method: of the rows.

    Raises:
        ValueError: no scene has both distances.
    """
    distances = {
        name: {
            row["seed"]: float(row["wasserstein"])
            for row in rows
            if (row["task"], row["method"]) == (task, name) and row["wasserstein"] not in (None, "")
        }
        for name in (method, FLOOR)
    }
    both = [seed for seed in distances[FLOOR] if seed in distances[method]]
    if not both:
        raise ValueError(f"rows must have a scene of {task} with {method} and {FLOOR}, got none")
    return ratio_of_means(*([distances[name][seed] for seed in both] for name in (method, FLOOR)))


def ratio_table(rows: Sequence[Row]) -> list[list[str]]:
    """Return `ratio_to_floor` by method and task, the first row the head."""
    tasks, methods = (dict.fromkeys(str(row[name]) for row in rows) for name in ("task", "method"))
    lines = [["W1, times that of the noise floor", *tasks]]
    for method in methods:
        if method != FLOOR:
            found = [ratio_to_floor(rows, task, method) for task in tasks]
            cells = ["{value:.2f} ({low:.2f}–{high:.2f})".format(**each) for each in found]
            lines.append([method, *cells])
    return lines
