"""Figures of adapted paths in the plane."""

from __future__ import annotations

from typing import TYPE_CHECKING

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

if TYPE_CHECKING:
    from smp_planner.planning.plan import Plan

__all__ = ["draw_plan"]


def draw_plan(plan: Plan, axes: Axes | None = None) -> Axes:
    """Draw demonstrations, obstacles and adapted paths; those that collide are dotted.

    Args:
        plan: of paths in the plane; its `display` may hold "demonstrations", arrays (T_j, 2), and
            "outlines" of obstacles, arrays (N, 2).
        axes: to draw into; None makes a figure of its own, which is `axes.figure` of the result.

    Raises:
        ValueError: the paths are not in the plane.
    """
    if plan.trajectories.shape[-1] != 2:
        raise ValueError(
            f"only paths in the plane can be drawn, got D = {plan.trajectories.shape[-1]}"
        )
    if axes is None:
        axes = Figure(figsize=(5.0, 5.0), layout="constrained").add_subplot()
    for index, path in enumerate(plan.display.get("demonstrations", ())):
        label = "demonstrations" if index == 0 else None
        axes.plot(*path.T, color="tab:red", linewidth=1.0, linestyle="--", label=label)
    for index, path in enumerate(plan.trajectories):
        style = "-" if plan.collision_free[index] else ":"
        axes.plot(*path.T, color="tab:green", linewidth=0.8, alpha=0.6, linestyle=style)
    axes.plot(*plan.best.T, color="tab:orange", linewidth=2.0, label="chosen path")
    axes.plot([], [], color="tab:green", label=f"{len(plan.trajectories)} adapted paths")
    for outline in plan.display.get("outlines", ()):
        axes.add_patch(Polygon(outline, color="black"))
    axes.set_aspect("equal")
    axes.legend(frameon=False)
    return axes
