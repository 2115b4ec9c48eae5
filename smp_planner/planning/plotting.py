"""Figures of plans: paths in the plane, in space or of a robot's tool; joints over the phase."""

from __future__ import annotations

import io
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from smp_gym.arrays import FloatArray
from smp_gym.geometry.faces import body_faces
from smp_gym.scene import Obstacle
from smp_planner.planning.particle_groups import (
    CHOSEN,
    DEMONSTRATED,
    OBSTACLE,
    particle_groups,
)

if TYPE_CHECKING:
    from smp_planner.planning.plan import Plan

__all__ = ["draw_joints", "draw_plan", "picture"]

_LIMIT_SHOWN = 0.6
"""Largest distance, rad or m, of a joint limit from what is drawn at which it is drawn, too."""


def draw_plan(plan: Plan, axes: Axes | None = None) -> Axes:
    """Draw demonstrations, obstacles and particles in the colours of their homotopy classes.

    Particles that are not good are dotted. Of a robot the paths of its tool are drawn.

    Args:
        plan: its `display` may hold "demonstrations", arrays (T_j, D), "tool_demonstrations" of a
            robot, arrays (T_j, 3) m, "outlines" of obstacles in the plane, arrays (N, 2), and
            "obstacles" in space.
        axes: to draw into, with projection "3d" in space; None makes a figure of its own, which is
            ``axes.figure`` of the result.

    Raises:
        ValueError: the paths are neither in the plane nor in space, nor of a robot's tool.
    """
    of_tool = plan.tool_paths is not None
    paths = plan.tool_paths if plan.tool_paths is not None else plan.trajectories
    dimension = paths.shape[-1]
    if dimension not in (2, 3):
        raise ValueError(
            "only paths in the plane, in space or of a robot's tool can be drawn, got "
            f"D = {dimension}; plot_joints draws coordinates over the phase"
        )
    own = None
    if axes is None:
        own = Figure(figsize=(5.5, 5.5), layout="constrained")
        axes = own.add_subplot(projection="3d" if dimension == 3 else None)
    _lines(plan, axes, paths, "tool_demonstrations" if of_tool else "demonstrations")
    if dimension == 2:
        for outline in plan.display.get("outlines", ()):
            axes.add_patch(Polygon(outline, color="black"))
    else:
        _draw_bodies(axes, plan.display.get("obstacles", ()))
        for name in "xyz":
            getattr(axes, f"set_{name}label")(f"{name}, m" if of_tool else name)
    axes.set_aspect("equal")
    if own is None:
        axes.legend(frameon=False, fontsize="small", loc="upper right")
    else:
        own.legend(frameon=False, fontsize="small", loc="outside lower center", ncols=3)
    return axes


def draw_joints(plan: Plan) -> Figure:
    """Draw each coordinate over the phase, a panel each, with the joint limits that are near.

    Args:
        plan: its `display` may hold "demonstrations", and of a robot "joints", their names, and
            "model", a `RobotModel`, whose limits are drawn.
    """
    count = plan.trajectories.shape[-1]
    columns = min(count, 4 if count > 6 else 3)
    rows = -(-count // columns)
    figure = Figure(figsize=(3.0 * columns, 2.2 * rows + 0.6), layout="constrained")
    panels = np.ravel(figure.subplots(rows, columns, sharex=True, squeeze=False))
    names = plan.display.get("joints") or [f"coordinate {d}" for d in range(count)]
    model = plan.display.get("model")
    for number, (panel, name) in enumerate(zip(panels, names, strict=False)):
        values = _over_phase(plan.trajectories[..., number])
        shown = {
            "demonstrations": [
                _over_phase(path[:, number]) for path in plan.display.get("demonstrations", ())
            ]
        }
        _lines(plan, panel, values, "demonstrations", shown)
        if model is not None:
            low, high = panel.get_ylim()
            for limit in (model.lower[number], model.upper[number]):
                if low - _LIMIT_SHOWN < limit < high + _LIMIT_SHOWN:
                    panel.axhline(limit, color="black", linewidth=1.2, label="joint limit")
        unit = "" if model is None else f", {model.units[number]}"
        panel.set_title(f"{name}{unit}", fontsize="medium")
    for panel in panels[count:]:
        panel.set_visible(False)
    for panel in panels[max(0, count - columns) : count]:
        panel.set_xlabel("phase")
    found: dict[str, Any] = {}
    for panel in panels[:count]:
        found.update(zip(*reversed(panel.get_legend_handles_labels()), strict=True))
    figure.legend(found.values(), found.keys(), loc="outside lower center", ncols=4, frameon=False)
    return figure


def picture(plan: Plan) -> bytes:
    """Return a plan as a PNG file: its paths where they can be drawn, otherwise its coordinates."""
    if plan.tool_paths is not None or plan.trajectories.shape[-1] in (2, 3):
        figure: Any = draw_plan(plan).figure
    else:
        figure = draw_joints(plan)
    file = io.BytesIO()
    figure.savefig(file, format="png")
    return file.getvalue()


def _over_phase(values: FloatArray) -> FloatArray:
    """Return values (..., T) as lines (..., T, 2) over the phase."""
    phase = np.broadcast_to(np.linspace(0.0, 1.0, values.shape[-1]), values.shape)
    return np.stack([phase, values], axis=-1)


def _lines(
    plan: Plan,
    axes: Axes,
    paths: FloatArray,
    demonstrated: str,
    display: Mapping[str, Any] | None = None,
) -> None:
    """Draw lines of demonstrations, particles (P, T, 2 or 3) and the chosen one, with labels."""
    shown = plan.display if display is None else display
    label: str | None = "demonstrations"
    for path in shown.get(demonstrated, ()):
        axes.plot(*path.T, color=DEMONSTRATED, linewidth=1.0, linestyle="--", label=label)
        label = None
    for group in particle_groups(plan):
        label = group.label
        for path in paths[group.members]:
            style = "-" if group.good else ":"
            axes.plot(*path.T, color=group.color, lw=1.0, alpha=0.7, linestyle=style, label=label)
            label = None
    axes.plot(*paths[plan.chosen].T, color=CHOSEN, linewidth=2.0, label="chosen particle")


def _draw_bodies(axes: Any, obstacles: Any) -> None:
    """Draw obstacles in space: bodies by their faces, clouds by their points."""
    for obstacle in obstacles:
        if isinstance(obstacle, Obstacle):
            faces = Poly3DCollection(
                body_faces(obstacle), facecolor=OBSTACLE, edgecolor="none", alpha=0.35
            )
            axes.add_collection3d(faces)
            axes.auto_scale_xyz(*np.concatenate(body_faces(obstacle)).T, had_data=True)
        else:
            axes.scatter(*obstacle.points.T, color=OBSTACLE, s=1.0, alpha=0.5)
