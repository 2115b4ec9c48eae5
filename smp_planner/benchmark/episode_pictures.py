"""Pictures of one episode: the scene with the particle set in 3-D, and the video."""

from __future__ import annotations

import errno
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym
import imageio.v2 as imageio
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Polygon
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from smp_gym.arrays import FloatArray
from smp_gym.atomic_files import replacing
from smp_gym.datasets.demonstrations import Demonstrations
from smp_gym.geometry.faces import body_faces
from smp_gym.observation import CONTROL_PERIOD
from smp_gym.robot.kinematics import GRASP_CENTER, PEN_TIP, end_effector_pose, link_transforms
from smp_gym.scene import Obstacle, Scene, fixtures
from smp_planner.benchmark.camera import Camera, Painter
from smp_planner.benchmark.episodes import (
    EpisodeKey,
    PlayedEpisode,
    PlayMethods,
    environment_id,
    play_episode,
)
from smp_planner.benchmark.films import ActionRecorder, film

__all__ = [
    "SceneLine",
    "carried_point",
    "draw_episode",
    "object_paths",
    "paint_scene",
    "planned_path",
    "scene_figure",
    "write_video",
]

FRAME_RATE = round(1.0 / CONTROL_PERIOD)
"""Frames per second of a video: real time."""

_HOLD_FRAMES = FRAME_RATE
_FREE, _COLLIDING, _CHOSEN, _DEMONSTRATION = "#7fa3ee", "#ea8585", "#f59e0b", "#4b5563"
_OBSTACLE, _BIN, _ARM = "#c9a27c", "#5fb3a8", "#374151"
_TABLE, _GRID, _SHADOW = "#f4f2ed", "#dcd8cf", "#d5d0c5"
_GRID_STEP = 0.2
# Depth, m, by which a white rim lies behind its line: more than the length of a piece.
_HALO = 0.04
# The chosen path is drawn this much nearer, m, to stand out among the others.
_FOREGROUND = 0.15
_AZIMUTH, _ELEVATION, _DISTANCE = -28.0, 28.0, 2.2


def object_paths(trajectories: FloatArray, point: FloatArray = GRASP_CENTER) -> FloatArray:
    """Return the path of the grasped object's centre, or of another point, along trajectories.

    Args:
        trajectories: (..., T, 6) rad.
        point: (3,) m, fixed in the end-effector frame.

    Returns:
        (..., T, 3) m, in the base frame.
    """
    pose = end_effector_pose(trajectories)
    paths: FloatArray = pose[..., :3, 3] + pose[..., :3, :3] @ np.asarray(point)
    return paths


def carried_point(scene: Scene) -> FloatArray:
    """Return the point (3,) m of the end-effector frame whose path is drawn."""
    return GRASP_CENTER if scene.manipulated is not None else PEN_TIP


def _on_table(points: FloatArray) -> FloatArray:
    return points * (1.0, 1.0, 0.0)


def _outline(body: Obstacle) -> FloatArray:
    """Return the outline of a body as seen from above, (V, 2) m."""
    points = np.concatenate(body_faces(body))[:, :2]
    outline: FloatArray = points[ConvexHull(points).vertices]
    return outline


def _arm(scene: Scene) -> FloatArray:
    """Return the joints of the arm at the start, from the base to the object, (9, 3) m."""
    start = np.array(scene.start)
    joints = link_transforms(start)[:, :3, 3]
    return np.concatenate([np.zeros((1, 3)), joints, object_paths(start)[None]])


def _paint_table(painter: Painter, points: FloatArray) -> None:
    """Paint the part of the table under all points, with a grid of `_GRID_STEP`."""
    low = np.floor(points.min(axis=0) / _GRID_STEP) * _GRID_STEP
    high = np.ceil(points.max(axis=0) / _GRID_STEP) * _GRID_STEP
    corners = [(low[0], low[1]), (high[0], low[1]), (high[0], high[1]), (low[0], high[1])]
    painter.flat(np.array([(*corner, 0.0) for corner in corners]), _TABLE, _GRID)
    for axis in (0, 1):
        for value in np.arange(low[axis], high[axis] + 1e-9, _GRID_STEP):
            line = np.array([(*low[:2], 0.0), (*high[:2], 0.0)])
            line[:, axis] = value
            painter.flat_line(line, _GRID, 0.6)


@dataclass(frozen=True)
class SceneLine:
    """A line in a scene.

    Attributes:
        path: (N, 3) m.
        color: of the line.
        width: points.
        dashed: whether it is dashed.
        rimmed: whether it has a white rim and stands out among others.
    """

    path: FloatArray
    color: str
    width: float = 0.9
    dashed: bool = False
    rimmed: bool = False


def paint_scene(
    axes: Any,
    scene: Scene,
    lines: Sequence[SceneLine],
    azimuth: float = _AZIMUTH,
    within: Sequence[SceneLine] = (),
) -> None:
    """Paint a scene, the arm at its start, and lines, in perspective.

    Args:
        axes: flat axes of matplotlib, fitted to the picture.
        scene: what is painted.
        lines: each hidden by what is before it.
        azimuth: degrees, from where it is seen; see `Camera`.
        within: further lines that the view includes, so that pictures can be compared.
    """
    arm = _arm(scene)
    bin_parts = fixtures(scene)[1:]
    bodies = [*scene.obstacles, *bin_parts]
    corners = [np.concatenate(body_faces(body)) for body in bodies]
    points = np.concatenate([arm, *(line.path for line in (*lines, *within)), *corners])
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    target = (float(middle[0]), float(middle[1]), float(middle[2]))
    painter = Painter(Camera(target, azimuth, _ELEVATION, _DISTANCE))
    _paint_table(painter, points)
    for body in bodies:
        outline = _outline(body)
        painter.flat(np.column_stack([outline, np.zeros(len(outline))]), _SHADOW)
    for line in lines:
        if line.rimmed:
            painter.flat_line(_on_table(line.path), "#b8b2a6", 2.0)
    for body in scene.obstacles:
        painter.body(body, _OBSTACLE)
    for body in bin_parts:
        painter.body(body, _BIN, alpha=0.3)
    painter.line(arm, "white", 10.0, nearer=-_HALO)
    painter.line(arm, _ARM, 8.0)
    for line in lines:
        if line.rimmed:
            painter.line(line.path, "white", line.width + 2.0, nearer=_FOREGROUND - _HALO)
            painter.line(line.path, line.color, line.width, nearer=_FOREGROUND)
        else:
            painter.line(line.path, line.color, line.width, dashed=line.dashed)
    painter.paint(axes)


def _draw_space(axes: Any, played: PlayedEpisode, demonstrations: FloatArray) -> None:
    plan, chosen, lines = played.plan, played.object_path, []
    if plan is not None:
        paths = object_paths(plan.trajectories, carried_point(played.scene))
        chosen = paths[plan.chosen]
        lines = [
            SceneLine(path, _FREE if free else _COLLIDING)
            for path, free in zip(paths, plan.collision_free, strict=True)
        ]
    lines += [SceneLine(path, _DEMONSTRATION, 1.2, dashed=True) for path in demonstrations]
    lines.append(SceneLine(chosen, _CHOSEN, 3.5, rimmed=True))
    paint_scene(axes, played.scene, lines)


def _draw_from_above(axes: Any, played: PlayedEpisode, demonstrations: FloatArray) -> None:
    scene, plan = played.scene, played.plan
    bin_parts = fixtures(scene)[1:]
    for bodies, color, alpha in ((bin_parts, _BIN, 0.4), (scene.obstacles, _OBSTACLE, 0.8)):
        for body in bodies:
            axes.add_patch(Polygon(_outline(body), facecolor=color, alpha=alpha, edgecolor="none"))
    executed = played.object_path[None, :, :2]
    groups: list[tuple[FloatArray, str, float, float]] = []
    if plan is not None:
        paths = object_paths(plan.trajectories, carried_point(scene))[..., :2]
        free, executed = plan.collision_free, paths[[plan.chosen]]
        groups = [(paths[~free], _COLLIDING, 0.8, 0.8), (paths[free], _FREE, 0.8, 0.8)]
    groups += [(executed, "white", 4.5, 1.0), (executed, _CHOSEN, 2.8, 1.0)]
    for chosen, color, width, alpha in groups:
        axes.add_collection(LineCollection(list(chosen), colors=color, lw=width, alpha=alpha))
    axes.add_collection(
        LineCollection(
            list(demonstrations[..., :2]), colors=_DEMONSTRATION, lw=0.9, linestyles="dashed"
        )
    )
    axes.plot(*_arm(scene)[:, :2].T, color=_ARM, lw=4, alpha=0.5, solid_capstyle="round")
    axes.plot(0, 0, "o", color=_ARM, ms=9)
    axes.set_aspect("equal")
    axes.autoscale_view()
    axes.set(xlabel="x, m", ylabel="y, m")
    axes.set_title("from above", fontsize=10, loc="left", color=_DEMONSTRATION)
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(labelsize=8)
    axes.grid(color="#e5e7eb", lw=0.5)
    axes.set_axisbelow(True)


def _legend_entries(played: PlayedEpisode, count: int) -> list[Any]:
    plan = played.plan
    of_particles = [Line2D([], [], color=_CHOSEN, lw=3.5, label="executed trajectory")]
    if plan is not None:
        free = int(plan.collision_free.sum())
        colliding = len(plan.collision_free) - free
        of_particles = [
            Line2D([], [], color=_CHOSEN, lw=3.5, label="chosen particle"),
            Line2D([], [], color=_FREE, lw=1.3, label=f"collision-free particles ({free})"),
            Line2D([], [], color=_COLLIDING, lw=1.3, label=f"colliding particles ({colliding})"),
        ]
    return [
        *of_particles,
        Line2D([], [], color=_DEMONSTRATION, lw=1.2, ls="--", label=f"demonstrations ({count})"),
        Line2D([], [], color=_ARM, lw=7, label="arm at the start", solid_capstyle="round"),
        Patch(color=_OBSTACLE, label="obstacles"),
        *([Patch(color=_BIN, alpha=0.6, label="goals")] if fixtures(played.scene)[1:] else []),
    ]


def scene_figure(played: PlayedEpisode, path: Path) -> None:
    """Draw scene, particles and demonstrations in 3-D and from above, and write a PNG.

    Lines are paths of the grasped object's centre, or of the pen's tip; the grid on the table has
    steps of 0.2 m.

    Args:
        played: the episode.
        path: of the image.
    """
    row = played.row
    shipped = Demonstrations.load(row.task).configurations
    demonstrations = object_paths(shipped, carried_point(played.scene))
    figure = Figure(figsize=(12.0, 6.4), dpi=160, facecolor="white")
    FigureCanvasAgg(figure)
    _draw_space(figure.add_axes((0.01, 0.01, 0.68, 0.87)), played, demonstrations)
    _draw_from_above(figure.add_axes((0.735, 0.09, 0.255, 0.50)), played, demonstrations)
    figure.legend(
        handles=_legend_entries(played, len(demonstrations)),
        loc="upper left",
        bbox_to_anchor=(0.72, 0.98),
        frameon=False,
        fontsize=9.5,
    )
    figure.text(0.02, 0.94, f"{row.key.cell.name}, {row.method}", fontsize=15, weight="bold")
    figure.text(
        0.02,
        0.905,
        f"{row.half} seed {row.seed}: {row.outcome}".lstrip(),
        fontsize=10,
        color=_DEMONSTRATION,
    )
    with replacing(path) as aside:
        figure.savefig(aside)


def write_video(frames: Sequence[NDArray[np.uint8]], path: Path) -> None:
    """Write frames as an MP4 in real time; the last one stays for a second.

    Args:
        frames: (H, W, 3) images of one size with even H and W; at least one.
        path: of the video.

    Raises:
        ValueError: there are no frames.
        OSError: the file cannot be written, or there is no ffmpeg.
    """
    if not frames:
        raise ValueError("frames must hold at least one image, got none")
    with replacing(path) as aside:
        try:
            writer: Any = imageio.get_writer(
                aside,
                fps=FRAME_RATE,
                codec="libx264",
                quality=7,
                macro_block_size=2,
                pixelformat="yuv420p",
            )
            with writer:
                for frame in (*frames, *[frames[-1]] * _HOLD_FRAMES):
                    writer.append_data(frame)
        except RuntimeError as error:
            raise FileNotFoundError(errno.ENOENT, str(error), "ffmpeg") from error


def planned_path(played: PlayedEpisode) -> FloatArray | None:
    """Return the path (T, 3) m of the chosen particle, of object or pen; None without a plan."""
    if played.plan is None:
        return None
    chosen = played.plan.trajectories[played.plan.chosen]
    return object_paths(chosen, carried_point(played.scene))


def draw_episode(
    player: PlayMethods, key: EpisodeKey, folder: Path, figure: bool, video: bool
) -> list[Path]:
    """Play one episode and write ``scene_CELL_METHOD.png`` and ``episode_CELL_METHOD.mp4``.

    Args:
        player: that plays the method.
        key: names the episode.
        folder: of the files; must exist.
        figure: whether to write the image.
        video: whether to write the video.

    Returns:
        The files that were written.
    """
    env = gym.make(environment_id(key.task), **key.cell.make_arguments())
    recorder = ActionRecorder()
    try:
        played = play_episode(key, env, player.policy(key), (recorder,), player.lists)
    finally:
        env.close()
    written = []
    if figure:
        written.append(folder / f"scene_{key.cell.name}_{key.method}.png")
        scene_figure(played, written[-1])
    if video:
        written.append(folder / f"episode_{key.cell.name}_{key.method}.mp4")
        write_video(film(played, recorder.actions, planned_path(played)), written[-1])
    return written
