"""Pictures of one episode: the scene with the particle set in 3-D, and the video."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import gymnasium as gym
import imageio.v2 as imageio
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Polygon
from matplotlib.ticker import MultipleLocator
from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection
from numpy.typing import NDArray
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from smp_gym.demonstrations import Demonstrations
from smp_gym.kinematics import GRASP_CENTER, end_effector_pose, link_transforms
from smp_gym.observation import CONTROL_PERIOD
from smp_gym.scene import TABLE, Obstacle, Scene, fixtures
from smp_planner.benchmark.episodes import EpisodeKey, Rollout, environment_id, roll_out
from smp_planner.policy import PlannerPolicy

__all__ = ["draw_episode", "object_paths", "scene_figure", "write_video"]

FRAME_RATE = round(1.0 / CONTROL_PERIOD)
"""Frames per second of a video: real time."""

_HOLD_FRAMES = FRAME_RATE
_ELEVATION, _AZIMUTH = 26.0, -52.0
_FREE, _COLLIDING, _CHOSEN, _DEMONSTRATION = "#1f77b4", "#d62728", "#f59e0b", "#6b7280"
_OBSTACLE, _BIN, _ARM = "#b08968", "#2a9d8f", "#374151"
_LIGHT = np.array([0.35, -0.45, 0.82])
_ROUND = 24

FloatArray = NDArray[np.float64]


def object_paths(trajectories: FloatArray) -> FloatArray:
    """Return the way of the grasped object's centre along trajectories.

    Args:
        trajectories: (..., T, 6) rad.

    Returns:
        (..., T, 3) m, in the base frame.
    """
    pose = end_effector_pose(trajectories)
    paths: FloatArray = pose[..., :3, 3] + pose[..., :3, :3] @ np.asarray(GRASP_CENTER)
    return paths


def _box_faces() -> list[FloatArray]:
    faces = []
    for axis in range(3):
        for side in (-1.0, 1.0):
            corners = np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])
            faces.append(np.insert(corners, axis, side, axis=1))
    return faces


def _round_faces(heights: FloatArray, radii: FloatArray) -> list[FloatArray]:
    """Return the quadrilaterals of a body of revolution about z."""
    angles = np.linspace(0.0, 2 * np.pi, _ROUND + 1)
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    rings = [
        np.column_stack([r * circle, np.full(len(circle), h)])
        for h, r in zip(heights, radii, strict=True)
    ]
    return [
        np.array([low[i], low[i + 1], high[i + 1], high[i]])
        for low, high in pairwise(rings)
        for i in range(_ROUND)
    ]


def _faces(obstacle: Obstacle) -> list[FloatArray]:
    """Return the polygons of a body in the base frame, each (V, 3) m."""
    if obstacle.shape == "box":
        unit = _box_faces()
    elif obstacle.shape == "cylinder":
        unit = _round_faces(np.array([-1.0, -1.0, 1.0, 1.0]), np.array([0.0, 1.0, 1.0, 0.0]))
    else:
        polar = np.linspace(-np.pi / 2, np.pi / 2, _ROUND // 2 + 1)
        unit = _round_faces(np.sin(polar), np.cos(polar))
    rotation = Rotation.from_quat(obstacle.quaternion).as_matrix()
    return [(face * obstacle.size) @ rotation.T + obstacle.position for face in unit]


def _shaded(faces: list[FloatArray], centre: FloatArray, color: str) -> FloatArray:
    """Return a colour per face, lighter where it faces the light."""
    base = np.array(to_rgb(color))
    colors = []
    for face in faces:
        outward = face.mean(axis=0) - centre
        length = np.linalg.norm(outward)
        brightness = 0.5 + 0.5 * (outward @ _LIGHT / length if length > 0 else 0.0)
        colors.append(np.clip(base * (0.6 + 0.45 * brightness), 0.0, 1.0))
    return np.array(colors)


def _draw_body(axes: Any, body: Obstacle, color: str, alpha: float) -> None:
    faces = _faces(body)
    colors = _shaded(faces, np.array(body.position), color)
    axes.add_collection3d(
        Poly3DCollection(
            faces,
            facecolors=np.column_stack([colors, np.full(len(colors), alpha)]),
            edgecolors=(1, 1, 1, 0.25) if body.shape == "box" else "none",
            linewidths=0.4,
        )
    )


def _draw_paths(axes: Any, paths: FloatArray, flat: bool, **style: Any) -> None:
    if not len(paths):
        return
    if flat:
        axes.add_collection(LineCollection(list(paths[..., :2]), **style))
    else:
        axes.add_collection3d(Line3DCollection(list(paths), **style))


def _draw_particles(
    axes: Any, rollout: Rollout, demonstrations: FloatArray, flat: bool = False
) -> None:
    plan = rollout.plan
    paths = object_paths(plan.trajectories)
    chosen = np.arange(len(paths)) == plan.chosen
    free = plan.collision_free
    _draw_paths(
        axes, demonstrations, flat, colors=_DEMONSTRATION, linestyles="dashed", linewidths=1.1
    )
    _draw_paths(axes, paths[~free & ~chosen], flat, colors=_COLLIDING, linewidths=0.8, alpha=0.4)
    _draw_paths(axes, paths[free & ~chosen], flat, colors=_FREE, linewidths=0.9, alpha=0.55)
    for color, width in (("white", 5.0), (_CHOSEN, 3.0)):
        _draw_paths(axes, paths[chosen], flat, colors=color, linewidths=width, zorder=20)


def _draw_flat_bodies(axes: Any, scene: Scene) -> None:
    """Draw the outlines of all bodies as seen from above."""
    bin_parts = fixtures(scene)[1:]
    for bodies, color, alpha in ((bin_parts, _BIN, 0.35), (scene.obstacles, _OBSTACLE, 0.75)):
        for body in bodies:
            points = np.concatenate(_faces(body))[:, :2]
            outline = points[ConvexHull(points).vertices]
            axes.add_patch(
                Polygon(outline, facecolor=color, alpha=alpha, edgecolor="white", lw=0.6)
            )


def _legend_entries(rollout: Rollout, count: int) -> list[Any]:
    plan = rollout.plan
    free = int(plan.collision_free.sum())
    entries = [
        Line2D([], [], color=_CHOSEN, lw=3, label="chosen particle"),
        Line2D([], [], color=_FREE, lw=1.2, label=f"collision-free particles ({free})"),
        Line2D(
            [], [], color=_COLLIDING, lw=1.2, label=f"colliding particles ({len(plan.good) - free})"
        ),
        Line2D([], [], color=_DEMONSTRATION, lw=1.1, ls="--", label=f"demonstrations ({count})"),
        Patch(color=_OBSTACLE, label="obstacles"),
        Patch(color=_BIN, alpha=0.5, label="bin"),
        Line2D([], [], color=_ARM, lw=4, label="arm at the start"),
    ]
    return entries


def _limits(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the corners of the box around all points, from the table up."""
    lower, upper = points.min(axis=0) - 0.03, points.max(axis=0) + 0.03
    lower[2] = 0.0
    return lower, upper


def _draw_space(axes: Any, rollout: Rollout, demonstrations: FloatArray) -> None:
    scene = rollout.scene
    arm = link_transforms(np.array(scene.start))[:, :3, 3]
    arm = np.concatenate([np.zeros((1, 3)), arm, object_paths(np.array(scene.start))[None]])
    bodies = [*scene.obstacles, *fixtures(scene)[1:]]
    points = np.concatenate(
        [
            arm,
            object_paths(rollout.plan.trajectories).reshape(-1, 3),
            demonstrations.reshape(-1, 3),
            *(np.concatenate(_faces(body)) for body in bodies),
        ]
    )
    lower, upper = _limits(points)
    top = TABLE.position[2] + TABLE.size[2]
    corners = [
        (lower[0], lower[1]),
        (upper[0], lower[1]),
        (upper[0], upper[1]),
        (lower[0], upper[1]),
    ]
    table = np.array([(*corner, top) for corner in corners])
    axes.add_collection3d(Poly3DCollection([table], facecolors="#f3f1ec", edgecolors="#d6d3cb"))
    for body in fixtures(scene)[1:]:
        _draw_body(axes, body, _BIN, 0.35)
    for body in scene.obstacles:
        _draw_body(axes, body, _OBSTACLE, 0.85)
    axes.plot(*arm.T, color=_ARM, lw=5, solid_capstyle="round", solid_joinstyle="round", alpha=0.9)
    axes.plot(*arm.T, color="white", marker="o", ms=3.5, lw=0)
    _draw_particles(axes, rollout, demonstrations)
    axes.set(xlim=(lower[0], upper[0]), ylim=(lower[1], upper[1]), zlim=(lower[2], upper[2]))
    axes.set_box_aspect(upper - lower, zoom=1.12)
    axes.set_proj_type("persp", focal_length=0.6)
    axes.view_init(_ELEVATION, _AZIMUTH)
    axes.set(xlabel="x, m", ylabel="y, m", zlabel="z, m")
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_pane_color((1, 1, 1, 0))
        axis._axinfo["grid"].update(color="#e5e7eb", linewidth=0.5)
        axis.set_major_locator(MultipleLocator(0.2))


def _draw_plan_view(axes: Any, rollout: Rollout, demonstrations: FloatArray) -> None:
    _draw_flat_bodies(axes, rollout.scene)
    _draw_particles(axes, rollout, demonstrations, flat=True)
    axes.plot(0, 0, "s", color=_ARM, ms=9)
    axes.annotate(
        "base", (0, 0), xytext=(8, -3), textcoords="offset points", color=_ARM, fontsize=8
    )
    axes.set_aspect("equal")
    axes.autoscale_view()
    axes.set(xlabel="x, m", ylabel="y, m")
    axes.set_title("from above", fontsize=10, loc="left")
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(color="#e5e7eb", lw=0.5)
    axes.set_axisbelow(True)


def scene_figure(rollout: Rollout, path: Path) -> None:
    """Draw scene, particles and demonstrations in 3-D and from above, and write a PNG.

    Lines are ways of the grasped object's centre; all axes have the same scale.

    Args:
        rollout: one played episode.
        path: of the image.
    """
    row = rollout.row
    configurations = Demonstrations.load(row.task).configurations
    demonstrations = object_paths(configurations)
    figure = Figure(figsize=(13.0, 7.0), dpi=150, facecolor="white")
    FigureCanvasAgg(figure)
    space = figure.add_axes((0.0, 0.0, 0.64, 0.93), projection="3d", computed_zorder=True)
    above = figure.add_axes((0.67, 0.10, 0.31, 0.50))
    _draw_space(space, rollout, demonstrations)
    _draw_plan_view(above, rollout, demonstrations)
    figure.legend(
        handles=_legend_entries(rollout, len(demonstrations)),
        loc="upper left",
        bbox_to_anchor=(0.66, 0.92),
        frameon=False,
        fontsize=10,
    )
    outcome = "success" if row.success else f"failed: {row.cause}"
    figure.text(0.02, 0.95, f"{row.task}, {row.method}", fontsize=15, weight="bold")
    figure.text(
        0.02,
        0.915,
        f"{row.difficulty}, seed {row.seed}: {outcome}",
        fontsize=10,
        color="#4b5563",
    )
    figure.savefig(path)


def write_video(frames: Sequence[NDArray[np.uint8]], path: Path) -> None:
    """Write frames as an MP4 in real time; the last one stays for a second.

    Args:
        frames: (H, W, 3) images of one size with even H and W; at least one.
        path: of the video.

    Raises:
        ValueError: there are no frames.
    """
    if not frames:
        raise ValueError("frames must hold at least one image, got none")
    writer: Any = imageio.get_writer(
        path, fps=FRAME_RATE, codec="libx264", quality=7, macro_block_size=2, pixelformat="yuv420p"
    )
    with writer:
        for frame in (*frames, *[frames[-1]] * _HOLD_FRAMES):
            writer.append_data(frame)


def draw_episode(key: EpisodeKey, folder: Path, figure: bool, video: bool) -> list[Path]:
    """Play one episode and write ``scene_TASK_METHOD.png`` and ``episode_TASK_METHOD.mp4``.

    Args:
        key: names the episode.
        folder: of the files; must exist.
        figure: whether to write the image.
        video: whether to write the video.

    Returns:
        The files that were written.
    """
    env = gym.make(
        environment_id(key.task),
        difficulty=key.difficulty,
        render_mode="rgb_array" if video else None,
    )
    try:
        rollout = roll_out(key, env, PlannerPolicy.make(key.method, key.task))
    finally:
        env.close()
    written = []
    if figure:
        written.append(folder / f"scene_{key.task}_{key.method}.png")
        scene_figure(rollout, written[-1])
    if video:
        written.append(folder / f"episode_{key.task}_{key.method}.mp4")
        write_video(rollout.frames, written[-1])
    return written
