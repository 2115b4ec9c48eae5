"""From rows to numbers with intervals: the summary of a run, and its table."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from smp_gym.datasets.frozen import HALVES
from smp_gym.suites import Cell
from smp_planner.benchmark.episodes import EpisodeRow
from smp_planner.benchmark.manifest import Manifest
from smp_planner.benchmark.map_accuracy import MapAccuracy
from smp_planner.benchmark.results_folder import write_table
from smp_planner.benchmark.statistics import CONFIDENCE, mean_interval, rate_interval

__all__ = [
    "CSV_COLUMNS",
    "overview",
    "summarise",
    "tables",
    "write_csv",
]

CSV_COLUMNS = tuple(f.name for f in fields(EpisodeRow) if f.name not in ("stage_times", "scene"))
"""Columns of ``episodes.csv``; the last three are times and differ from run to run."""

_RATES = ("success", "collision", "chosen_collision_free", "chosen_executable")
_MEANS = (
    "goal_error",
    "path_length",
    "clearance",
    "steps",
    "share_collision_free",
    "share_executable",
    "share_good",
    "chosen_clearance",
    "chosen_duration",
    "planning_time",
)
_REPLANNING = ("replans", "failed_replans", "replanning_time")


def _of_group(rows: Sequence[EpisodeRow]) -> dict[str, Any]:
    summary: dict[str, Any] = {"episodes": len(rows)}
    for name in _RATES:
        values = [value for row in rows if (value := getattr(row, name)) is not None]
        summary[name] = rate_interval(sum(values), len(values)) if values else None
    for name in _MEANS:
        values = [float(value) for row in rows if (value := getattr(row, name)) is not None]
        summary[name] = mean_interval(values) if values else None
    summary["replan_every"], summary["latency"] = rows[0].replan_every, rows[0].latency
    if rows[0].replan_every:
        for name in _REPLANNING:
            summary[name] = mean_interval([float(getattr(row, name)) for row in rows])
    times = [row.planning_time for row in rows]
    summary["planning_time"]["median"] = float(np.median(times))
    summary["planning_time"]["p95"] = float(np.percentile(times, 95))
    stages = sorted({stage for row in rows for stage in row.stage_times})
    summary["stage_times"] = {
        stage: float(np.mean([row.stage_times.get(stage, 0.0) for row in rows])) for stage in stages
    }
    summary["causes"] = dict(sorted(Counter(row.cause for row in rows if row.cause).items()))
    return summary


def summarise(
    manifest: Manifest, rows: Sequence[EpisodeRow], accuracy: MapAccuracy | None = None
) -> dict[str, Any]:
    """Return the summary of a run, ready for JSON.

    Rates carry Wilson intervals and means bootstrap intervals, both of level `CONFIDENCE`. Of
    frozen lists, each group also holds the summaries of the halves, under ``halves``.

    Args:
        manifest: of the run.
        rows: of its episodes; need not be all of them.
        accuracy: of the occupancy map on the run's scenes, if it was measured.
    """
    groups = []
    by_group: dict[tuple[Cell, str], list[EpisodeRow]] = {}
    for row in rows:
        by_group.setdefault((row.key.cell, row.method), []).append(row)
    for cell in manifest.cells:
        for method in manifest.methods:
            chosen = by_group.get((cell, method))
            if chosen:
                named = {"cell": cell.name, **asdict(cell), "method": method}
                groups.append({**named, **_of_group(chosen)})
                halves = {half: [row for row in chosen if row.half == half] for half in HALVES}
                groups[-1]["halves"] = {
                    half: _of_group(rows_of_half)
                    for half, rows_of_half in halves.items()
                    if rows_of_half
                }
    return {
        "suite": manifest.suite,
        "cells": [cell.name for cell in manifest.cells],
        "methods": list(manifest.methods),
        "seed": manifest.seed,
        "episodes": manifest.episodes,
        "frozen": manifest.frozen,
        "confidence": CONFIDENCE,
        "versions": dict(manifest.versions),
        "code": manifest.code,
        "map": asdict(accuracy) if accuracy else None,
        "groups": groups,
    }


def write_csv(path: Path, rows: Sequence[EpisodeRow]) -> None:
    """Write rows sorted by task, method, difficulty and seed; columns are `CSV_COLUMNS`."""
    ordered = sorted(rows, key=lambda row: row.key)
    write_table(
        path, CSV_COLUMNS, [[getattr(row, name) for name in CSV_COLUMNS] for row in ordered]
    )


def _percent(estimate: Mapping[str, float] | None) -> str:
    return _number(estimate, 100, 1)


def _number(estimate: Mapping[str, float] | None, scale: float, digits: int) -> str:
    if estimate is None:
        return "–"
    value, low, high = (scale * estimate[name] for name in ("value", "low", "high"))
    return f"{value:.{digits}f} [dim]({low:.{digits}f}–{high:.{digits}f})[/]"


def _when(group: Mapping[str, Any]) -> str:
    return f"{group['replan_every']}, {group['latency']}" if group["replan_every"] else "–"


def _origin(summary: Mapping[str, Any]) -> str:
    first, last = summary["seed"], summary["seed"] + summary["episodes"] - 1
    return "frozen list" if summary["frozen"] else f"seeds {first}–{last}"


def overview(summary: Mapping[str, Any]) -> Table:
    """Return the rates of success as a table: one column per method, one line per cell."""
    suite = f"suite {summary['suite']}, " if summary["suite"] else ""
    result = Table(
        title=f"success in %, {suite}{_origin(summary)}",
        caption=f"{summary['confidence']:.0%} Wilson intervals",
        title_justify="left",
        caption_justify="left",
    )
    result.add_column("")
    for method in summary["methods"]:
        result.add_column(method, justify="right")
    rates = {(g["cell"], g["method"]): _percent(g["success"]) for g in summary["groups"]}
    for cell in summary["cells"]:
        result.add_row(cell, *(rates.get((cell, method), "–") for method in summary["methods"]))
    return result


def tables(summary: Mapping[str, Any]) -> list[Table]:
    """Return the summary as a table for each cell: one column per method, one line per quantity."""
    groups = summary["groups"]
    cells = [name for name in summary["cells"] if any(g["cell"] == name for g in groups)]
    return [_table(summary, name, [g for g in groups if g["cell"] == name]) for name in cells]


def _table(summary: Mapping[str, Any], cell: str, groups: Sequence[Mapping[str, Any]]) -> Table:
    caption = f"{summary['confidence']:.0%} intervals: Wilson for rates, bootstrap for means"
    if accuracy := summary["map"]:
        caption += (
            f"\nmap: {accuracy['inside_occupied']:.2%} of points 1 cm or more inside are occupied, "
            f"{accuracy['outside_occupied']:.2%} of points 2–6 cm outside"
        )
    result = Table(
        title=f"{cell}, {_origin(summary)}",
        caption=caption,
        title_justify="left",
        caption_justify="left",
    )
    result.add_column("")
    for group in groups:
        result.add_column(group["method"], justify="right")
    lines: list[tuple[str, list[str]]] = [
        ("episodes", [str(g["episodes"]) for g in groups]),
        ("success, %", [_percent(g["success"]) for g in groups]),
        ("collision, %", [_percent(g["collision"]) for g in groups]),
        ("particles collision-free, %", [_percent(g["share_collision_free"]) for g in groups]),
        ("particles executable, %", [_percent(g["share_executable"]) for g in groups]),
        ("particles both, %", [_percent(g["share_good"]) for g in groups]),
        ("chosen: collision-free, %", [_percent(g["chosen_collision_free"]) for g in groups]),
        ("chosen: executable, %", [_percent(g["chosen_executable"]) for g in groups]),
        ("chosen: clearance, mm", [_number(g["chosen_clearance"], 1e3, 1) for g in groups]),
        ("goal error, mm", [_number(g["goal_error"], 1e3, 1) for g in groups]),
        ("path length, m", [_number(g["path_length"], 1.0, 2) for g in groups]),
        ("steps", [_number(g["steps"], 1.0, 0) for g in groups]),
        ("planning time, s", [_number(g["planning_time"], 1.0, 3) for g in groups]),
    ]
    if any(g["replan_every"] for g in groups):
        lines += [
            ("replanning: every, latency, steps", [_when(g) for g in groups]),
            ("replans", [_number(g["replans"], 1.0, 1) for g in groups]),
            ("  without a good particle", [_number(g["failed_replans"], 1.0, 1) for g in groups]),
            ("replanning time, s", [_number(g["replanning_time"], 1.0, 3) for g in groups]),
        ]
    halves = [half for half in HALVES if any(half in g["halves"] for g in groups)]
    lines[2:2] = [
        (f"  {half} half, %", [_percent(g["halves"].get(half, {}).get("success")) for g in groups])
        for half in halves
    ]
    for name, cells in lines:
        result.add_row(name, *cells)
    causes = [", ".join(f"{cause} {n}" for cause, n in g["causes"].items()) or "–" for g in groups]
    result.add_section()
    result.add_row("failures", *causes)
    return result
