"""From the rows of Table II to numbers with intervals, and to CSV, JSON and Markdown."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from smp_gym.assets import asset_path
from smp_gym.atomic_files import write_text
from smp_gym.scene import TASKS
from smp_planner.benchmark.results_folder import write_json, write_table
from smp_planner.benchmark.statistics import mean_interval, rate_interval
from smp_planner.experiments.table_two.repetitions import METHODS, RepetitionRow
from smp_planner.experiments.table_two.scenes import RULE, load_scenes

__all__ = ["markdown", "paper_rows", "summarise", "write_report"]

METHOD_TITLES = {
    "floor": "noise floor",
    "promp": "ProMP, not adapted",
    "smp": "SMP",
    "cpromp": "CProMP",
    "prompt_o": "ProMPT-O",
    "promp_diff": "ProMP-Diff",
    "cpromp_matched": "CProMP, one Gaussian",
    "prompt_o_matched": "ProMPT-O, one Gaussian",
    "promp_diff_matched": "ProMP-Diff, one Gaussian",
    "rrt_connect": "RRT-Connect",
}
"""Names of the methods in tables and figures."""

_METRICS = ("wasserstein", "frechet", "mmd", "mean_length", "min_length", "smoothness")
_PAPER_FILE = "paper_table_two.json"

Estimate = dict[str, float | int]


def _mean(values: Sequence[float]) -> Estimate | None:
    return mean_interval(values) if values else None


def _of_method(rows: Sequence[RepetitionRow]) -> dict[str, Any]:
    """Return the estimates of the repetitions of one task and method."""
    executed = [done for row in rows for done in row.success]
    planned = [done for row in rows for done in row.planned]
    free = [row.free_waypoints for row in rows if row.free_waypoints is not None]
    summary: dict[str, Any] = {
        "repetitions": len(rows),
        "repetitions_with_success": sum(any(row.success) for row in rows),
        "success": rate_interval(sum(executed), len(executed)) if executed else None,
        "planned": rate_interval(sum(planned), len(planned)) if planned else None,
        "free_waypoints": _mean(free),
        "causes": dict(Counter(c for row in rows for c in row.causes if c).most_common(5)),
        "modes": _mean([float(row.modes) for row in rows if row.success]),
        "entropy": _mean([row.entropy for row in rows if row.success]),
        "planning_time": _mean([row.planning_time for row in rows if row.success]),
    }
    for name in ("all", "successful", "floor"):
        found = [m for row in rows if (m := getattr(row, name)) is not None]
        summary[name] = {metric: _mean([getattr(m, metric) for m in found]) for metric in _METRICS}
    return summary


def summarise(rows: Sequence[RepetitionRow]) -> dict[str, Any]:
    """Return all estimates by task and method, intervals of 95 %.

    Rates have Wilson intervals over trajectories, means bootstrap intervals over repetitions;
    similarity over successful trajectories is the mean over those repetitions that have any.

    Args:
        rows: of any tasks and methods.
    """
    tasks: dict[str, Any] = {}
    for task in TASKS:
        of_task = [row for row in rows if row.task == task]
        found = {
            method: _of_method(chosen)
            for method in METHODS
            if (chosen := [row for row in of_task if row.method == method])
        }
        if found:
            tasks[task] = found
    seeds = {task: scene.seed for task, scene in load_scenes().items()}
    return {"rule": RULE, "seeds": seeds, "tasks": tasks, "paper": paper_rows()}


def paper_rows() -> list[dict[str, str]]:
    """Return the rows of the paper's own table, figures as printed there."""
    content = json.loads(asset_path("experiments", _PAPER_FILE).read_text(encoding="utf-8"))
    rows: list[dict[str, str]] = content["rows"]
    return rows


def _cell(estimate: Mapping[str, float] | None, scale: float, digits: int) -> str:
    if estimate is None:
        return "–"
    value, low, high = (scale * estimate[name] for name in ("value", "low", "high"))
    if round(low, digits) == round(high, digits):
        return f"{value:.{digits}f}"
    return f"{value:.{digits}f} ({low:.{digits}f} to {high:.{digits}f})"


_Column = tuple[str, Callable[[Mapping[str, Any]], str]]

_SUCCESS_COLUMNS: tuple[_Column, ...] = (
    ("repetitions", lambda s: str(s["repetitions"])),
    ("executed with success, %", lambda s: _cell(s["success"], 100, 1)),
    ("planned with success, %", lambda s: _cell(s["planned"], 100, 1)),
    ("free waypoints, %", lambda s: _cell(s["free_waypoints"], 100, 1)),
    ("modes", lambda s: _cell(s["modes"], 1, 1)),
    ("entropy, nats", lambda s: _cell(s["entropy"], 1, 2)),
)


def _similarity_columns(part: str) -> tuple[_Column, ...]:
    formats = {
        "wasserstein": ("W1, cm", 100, 2),
        "frechet": ("Fréchet, cm", 100, 2),
        "mmd": ("MMD", 1, 3),
        "mean_length": ("mean length, m", 1, 3),
        "min_length": ("least length, m", 1, 3),
        "smoothness": ("log jerk", 1, 2),
    }

    def column(metric: str, scale: float, digits: int) -> Callable[[Mapping[str, Any]], str]:
        return lambda s: _cell(s[part][metric], scale, digits)

    return tuple(
        (title, column(metric, scale, digits)) for metric, (title, scale, digits) in formats.items()
    )


def _lines(titles: Iterable[str], rows: Iterable[tuple[str, Iterable[str]]]) -> list[str]:
    """Return a table in Markdown, a row for each method and its cells."""
    header = ["method", *titles]
    lines = [" | ".join(header), "|".join(["---"] * len(header))]
    lines += [" | ".join((METHOD_TITLES[method], *cells)) for method, cells in rows]
    return [f"| {lines[0]} |", f"|{lines[1]}|", *(f"| {line} |" for line in lines[2:])]


def _table(methods: Mapping[str, Any], columns: Sequence[_Column]) -> list[str]:
    rows = ((method, [show(of_it) for _, show in columns]) for method, of_it in methods.items())
    return _lines((title for title, _ in columns), rows)


_OVERVIEW: tuple[_Column, ...] = (
    ("Executed with success, %:", lambda s: _cell(s["success"], 100, 1)),
    (
        "W1 of what was executed with success, cm:",
        lambda s: _cell(s["successful"]["wasserstein"], 100, 1),
    ),
    ("Fréchet distance of it, cm:", lambda s: _cell(s["successful"]["frechet"], 100, 1)),
    ("MMD of it:", lambda s: _cell(s["successful"]["mmd"], 1, 2)),
)


def _overview(tasks: Mapping[str, Any]) -> list[str]:
    """Return tables with a row for each method and a column for each task."""
    executed = {
        task: {m: s for m, s in methods.items() if s["success"] is not None}
        for task, methods in tasks.items()
    }
    methods = [m for m in METHODS if any(m in of_task for of_task in executed.values())]
    lines = []
    for title, show in _OVERVIEW:
        rows = [
            (m, [show(of_task[m]) if m in of_task else "–" for of_task in executed.values()])
            for m in methods
        ]
        lines += ["", title, "", *_lines(tasks, rows)]
    return lines


def _paper_table(rows: Sequence[Mapping[str, str]]) -> list[str]:
    names = ("wasserstein", "frechet", "mmd", "success", "mean_length", "min_length")
    titles = ("W.D", "F.D", "M.M.D", "Succ.Rate", "Avg.Traj.Len", "Min.Traj.Len")
    return _lines(titles, ((row["method"], [row[name] for name in names]) for row in rows))


def markdown(summary: Mapping[str, Any]) -> str:
    """Return all estimates as tables, the paper's own beside ours.

    Args:
        summary: from `summarise`.
    """
    lines = [
        "# Table II",
        "",
        "Intervals of 95 %: Wilson over trajectories for rates, bootstrap over repetitions for the",
        "rest. W1, Fréchet and MMD are against 1000 draws of the unadapted primitive. The noise",
        "floor is a fresh draw of it, as many as there are particles, or, beside the successful",
        "ones, as many as these are.",
        "",
        f"Scenes: {summary['rule']}.",
        *_overview(summary["tasks"]),
    ]
    for task, methods in summary["tasks"].items():
        executed = {m: s for m, s in methods.items() if s["success"] is not None}
        lines += ["", f"## {task} (seed {summary['seeds'][task]})", ""]
        lines += ["Success and modes, modes of the trajectories that were executed with success:"]
        lines += ["", *_table(executed, _SUCCESS_COLUMNS)]
        lines += ["", "All particles:", "", *_table(methods, _similarity_columns("all"))]
        lines += ["", "Those that were executed with success:", ""]
        lines += _table(executed, _similarity_columns("successful"))
        lines += ["", "The noise floor of as many:", ""]
        lines += _table(executed, _similarity_columns("floor"))
        lines += ["", "The paper's, as printed there:", ""]
        lines += _paper_table([row for row in summary["paper"] if row["task"] == task])
    return "\n".join(lines) + "\n"


def _write_repetitions(path: Path, rows: Sequence[RepetitionRow]) -> None:
    plain = ("task", "method", "repetition")
    counted = ("free_waypoints", "modes", "entropy", "planning_time")
    parts = [(part, metric) for part in ("all", "successful", "floor") for metric in _METRICS]
    header = [*plain, "executed", "succeeded", "planned", *counted]
    header += [f"{part}_{metric}" for part, metric in parts]
    body = []
    for row in rows:
        found = {part: asdict(m) if (m := getattr(row, part)) else {} for part, _ in parts}
        body.append(
            [
                *(getattr(row, name) for name in plain),
                len(row.success),
                sum(row.success),
                sum(row.planned),
                *(getattr(row, name) for name in counted),
                *(found[part].get(metric) for part, metric in parts),
            ]
        )
    write_table(path, header, body)


def _write_trajectories(path: Path, rows: Sequence[RepetitionRow]) -> None:
    header = ("task", "method", "repetition", "particle", "success", "cause", "steps", "planned")
    body = [
        (row.task, row.method, row.repetition, particle, *values)
        for row in rows
        for particle, values in enumerate(
            zip(row.success, row.causes, row.steps, row.planned, row.lengths, strict=True)
        )
    ]
    write_table(path, (*header, "length"), body)


def write_report(rows: Sequence[RepetitionRow], folder: Path) -> dict[str, Any]:
    """Write ``trajectories.csv``, ``repetitions.csv``, ``summary.json`` and ``table_two.md``.

    Args:
        rows: of any tasks and methods.
        folder: must exist.

    Returns:
        The summary.
    """
    summary = summarise(rows)
    _write_trajectories(folder / "trajectories.csv", rows)
    _write_repetitions(folder / "repetitions.csv", rows)
    write_json(folder / "summary.json", summary)
    write_text(folder / "table_two.md", markdown(summary))
    return summary
