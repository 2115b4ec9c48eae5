"""Figures of paths in the plane: demonstrations red, adapted paths green, obstacles black."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle as Disc

from smp_gym.arrays import FloatArray
from smp_gym.atomic_files import replacing
from smp_planner.experiments.lasa_scenes import LasaScene
from smp_planner.library.smp import AnyOf, ViaPoint

__all__ = ["draw_side_by_side"]

_DEMONSTRATION, _ADAPTED, _OLD_END, _NEW_END = "#c9252b", "#2e9e44", "#2563c4", "#c9252b"
_WIDTH, _LEAST_PANEL, _GREATEST_PANEL, _TEXT = 9.0, 3.0, 5.0, 0.9
"""Inches: of a figure, unless that makes its panels too small or too great; of title and legend."""

_DPI = 100


def draw_side_by_side(
    panels: Mapping[str, FloatArray],
    demonstrations: Sequence[FloatArray],
    scenes: LasaScene | Sequence[LasaScene],
    file: Path,
) -> None:
    """Write a figure with a panel for each set of paths, all to one scale.

    Args:
        panels: titles, and paths (P, T, 2) mm.
        demonstrations: (T, 2) mm each.
        scenes: of all panels, or one for each.
        file: to write, its suffix says in which format; its folder is made if there is none.

    Raises:
        ValueError: scenes and panels are not equally many.
    """
    each = [scenes] * len(panels) if isinstance(scenes, LasaScene) else list(scenes)
    if len(each) != len(panels):
        raise ValueError(f"scenes must be {len(panels)}, one for each panel, got {len(each)}")
    everything = [*demonstrations, *(path for paths in panels.values() for path in paths)]
    lower = np.min([path.min(axis=0) for path in everything], axis=0)
    upper = np.max([path.max(axis=0) for path in everything], axis=0)
    width, height = upper - lower
    panel = min(max(_WIDTH / len(panels), _LEAST_PANEL), _GREATEST_PANEL)
    size = (panel * len(panels), panel * height / width + _TEXT)
    figure = Figure(figsize=size, layout="constrained")
    axes = figure.subplots(1, len(panels), sharex=True, sharey=True, squeeze=False)[0]
    for ax, (title, paths), scene in zip(axes, panels.items(), each, strict=True):
        _draw(ax, paths, demonstrations, scene)
        ax.set_title(title, fontsize=10)
    axes[0].set_xlim(lower[0] - 0.03 * width, upper[0] + 0.03 * width)
    axes[0].set_ylim(lower[1] - 0.03 * height, upper[1] + 0.03 * height)
    handles = _legend(each, demonstrations)
    columns = min(len(handles), 3 * len(panels))
    figure.legend(handles=handles, loc="outside lower center", ncols=columns, fontsize=9)
    file.parent.mkdir(parents=True, exist_ok=True)
    with replacing(file) as aside:
        figure.savefig(aside, dpi=_DPI)


def _draw(
    ax: Axes, paths: FloatArray, demonstrations: Sequence[FloatArray], scene: LasaScene
) -> None:
    for path in paths:
        ax.plot(*path.T, color=_ADAPTED, linewidth=0.7, zorder=1)
    for path in demonstrations:
        ax.plot(*path.T, color=_DEMONSTRATION, linewidth=0.7, zorder=2)
    for obstacle in scene.obstacles:
        ax.add_patch(Disc(obstacle.center, obstacle.radius, color="black", zorder=3))
    for via in scene.via_points:
        for option in via.options if isinstance(via, AnyOf) else (via,):
            assert isinstance(option, ViaPoint)
            ax.plot(*option.position, "k*", markersize=9, zorder=4)
    if _ends_anew(scene, demonstrations):
        assert scene.goal is not None
        old = np.mean([path[-1] for path in demonstrations], axis=0)
        ax.plot(*old, "o", color=_OLD_END, markersize=6, zorder=4)
        ax.plot(*scene.goal, "o", color=_NEW_END, markersize=6, zorder=4)
    ax.set_aspect("equal")
    ax.set_axis_off()


def _ends_anew(scene: LasaScene, demonstrations: Sequence[FloatArray]) -> bool:
    return scene.goal is not None and not np.allclose(
        np.mean([path[-1] for path in demonstrations], axis=0), scene.goal
    )


def _legend(scenes: Sequence[LasaScene], demonstrations: Sequence[FloatArray]) -> list[Line2D]:
    handles = [
        Line2D([], [], color=_DEMONSTRATION, label="demonstrations"),
        Line2D([], [], color=_ADAPTED, label="adapted"),
    ]
    if any(scene.obstacles for scene in scenes):
        handles.append(Line2D([], [], color="black", marker="o", ls="", label="obstacles"))
    if any(scene.via_points for scene in scenes):
        handles.append(Line2D([], [], color="black", marker="*", ls="", label="via-points"))
    if any(_ends_anew(scene, demonstrations) for scene in scenes):
        handles.append(Line2D([], [], color=_OLD_END, marker="o", ls="", label="old end"))
        handles.append(Line2D([], [], color=_NEW_END, marker="o", ls="", label="new end"))
    return handles
