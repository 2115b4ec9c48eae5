"""Table II as a figure: each metric of each method, with its interval, task by task."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from smp_gym.atomic_files import replacing
from smp_planner.experiments.table_two.report import METHOD_TITLES

__all__ = ["draw_table"]

_COLORS = {
    "floor": "#9ca3af",
    "promp": "#9ca3af",
    "smp": "#2563eb",
    "cpromp": "#d97706",
    "prompt_o": "#059669",
    "promp_diff": "#be185d",
    "rrt_connect": "#374151",
}

_PANELS: tuple[tuple[str, float, Callable[[Mapping[str, Any]], Any]], ...] = (
    ("executed with success, %", 100.0, lambda s: s["success"]),
    ("W1 of the successful, cm", 100.0, lambda s: s["successful"]["wasserstein"]),
    ("Fréchet of the successful, cm", 100.0, lambda s: s["successful"]["frechet"]),
    ("MMD of the successful", 1.0, lambda s: s["successful"]["mmd"]),
    ("mean length, m", 1.0, lambda s: s["successful"]["mean_length"]),
    ("modes of the successful", 1.0, lambda s: s["modes"]),
)
_FLOORED = {"wasserstein": 1, "frechet": 2, "mmd": 3}


def _point(axes: Any, y: int, estimate: Mapping[str, float], scale: float, method: str) -> None:
    value, low, high = (scale * estimate[name] for name in ("value", "low", "high"))
    matched = method.endswith("_matched")
    color = _COLORS[method.removesuffix("_matched")]
    axes.plot([low, high], [y, y], color=color, lw=2.2, solid_capstyle="round")
    face = "white" if matched else color
    axes.plot([value], [y], "o", ms=6.5, mfc=face, mec=color, mew=1.6)


def draw_table(summary: Mapping[str, Any], path: Path) -> None:
    """Draw all tasks of a summary and write a PNG.

    Args:
        summary: from `report.summarise`.
        path: of the image.
    """
    tasks = summary["tasks"]
    heights = [
        sum(s["success"] is not None for s in methods.values()) for methods in tasks.values()
    ]
    figure = Figure(
        figsize=(15.0, 0.9 + sum(0.34 * count + 0.75 for count in heights)),
        dpi=130,
        layout="constrained",
        facecolor="white",
    )
    FigureCanvasAgg(figure)
    grid = figure.subplots(
        len(tasks), len(_PANELS), squeeze=False, gridspec_kw={"height_ratios": heights}
    )
    for row, (task, methods) in zip(grid, tasks.items(), strict=True):
        shown = [m for m, s in methods.items() if s["success"] is not None]
        for column, (axes, (title, scale, get)) in enumerate(zip(row, _PANELS, strict=True)):
            for y, method in enumerate(shown):
                estimate = get(methods[method])
                if estimate is not None:
                    _point(axes, y, estimate, scale, method)
            for metric, number in _FLOORED.items():
                floor = methods.get("floor", {}).get("all", {}).get(metric)
                if number == column and floor is not None:
                    axes.axvline(scale * floor["value"], color="#9ca3af", lw=1.2, ls="--")
            _dress(axes, shown, column, title if row is grid[0] else "")
        row[0].text(
            -0.02, 1.06, task, transform=row[0].transAxes, ha="right", weight="bold", fontsize=11
        )
    figure.suptitle(
        "Intervals of 95 %. Dashed: noise floor of 42 draws of the unadapted primitive. "
        "Hollow: one Gaussian for both modes.",
        fontsize=9.5,
        color="#4b5563",
        x=0.01,
        ha="left",
    )
    with replacing(path) as aside:
        figure.savefig(aside)


def _dress(axes: Any, methods: list[str], column: int, title: str) -> None:
    axes.set_ylim(len(methods) - 0.4, -0.6)
    axes.set_yticks(range(len(methods)), [METHOD_TITLES[m] for m in methods] if column == 0 else [])
    axes.tick_params(labelsize=8.5, length=0)
    axes.spines[["top", "right", "left"]].set_visible(False)
    axes.grid(axis="x", color="#e5e7eb", lw=0.8)
    axes.set_axisbelow(True)
    if column == 0:
        axes.set_xlim(-3, 103)
    if title:
        axes.set_title(title, fontsize=10, loc="left", pad=18)
