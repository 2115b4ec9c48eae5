"""Figures 3 to 6 of the paper: particles before and after, two modes of one scene, two new ends."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

import smp_gym  # noqa: F401  (registers the environments)
from smp_gym.atomic_files import replacing
from smp_gym.datasets.demonstrations import Demonstrations
from smp_gym.robot.kinematics import end_effector_pose, inverse_kinematics
from smp_gym.rollout import FrameRecorder, rollout
from smp_gym.sampling import sample_scene
from smp_gym.scene import PAD_DEPTH, Goal, ManipulatedObject, Obstacle, Scene
from smp_gym.tasks.double_sided_placement.rules import NOMINAL_PADS, START_CONFIGURATION
from smp_planner.benchmark.episode_pictures import (
    SceneLine,
    carried_point,
    object_paths,
    paint_scene,
    write_video,
)
from smp_planner.benchmark.episodes import environment_id
from smp_planner.benchmark.metrics import rms_distances
from smp_planner.planning.plan import Plan
from smp_planner.policy.planner_policy import PlannerPolicy
from smp_planner.policy.tracking import Track

__all__ = [
    "TwoModes",
    "draw_before_and_after",
    "draw_two_modes",
    "draw_two_sides",
    "find_two_modes",
    "modulated_scene",
]

FRAME_SIZE = (640, 480)
"""Width and height of the pictures of an episode, pixels."""

SHIFT = 0.15
"""Shift, m, of the left end towards the middle in Fig. 4. The right one is lifted to
`PAD_DEPTH`, the highest that a pad can stand: by 11.5 cm, where the paper has 15 cm."""

_START_SHIFT = (-0.06, 0.0, 0.06)
"""Offset, m, of the start of Fig. 4 from that of the demonstrations."""

_FREE, _COLLIDING, _FAINT, _DARK = "#7fa3ee", "#ea8585", "#b9c6de", "#4b5563"
_MODES = ("#f59e0b", "#059669")
_BEFORE: dict[str, Any] = {"inference": "quick", "iterations": 1, "step_size": 1e-12, "retries": 0}
_TASK_TITLES = {
    "DrawS": "Draw-S",
    "Placement": "Placement",
    "PushLiftBox": "Push-Lift-Box",
    "DoubleSidedPlacement": "Placement on double sides",
}
_STILLS = 5
_LEAST_MODE_SHARE = 0.1
"""Share of the good particles that each of two modes must hold."""

_FAR_CAMERA = {"distance": 1.7, "target": (0.32, 0.0, 0.3)}
_FRONT_CAMERA = {"yaw": 95.0, "pitch": -35.0}
_FRONT_AZIMUTH = 12.0


def _plan(policy: PlannerPolicy, env: gym.Env[Any, Any], scene: Scene) -> Plan:
    """Return the plan for a scene, on one thread."""
    torch.set_num_threads(1)
    observation, _ = env.reset(options={"scene": scene})
    return policy.plan(observation)


def _lines(scene: Scene, plan: Plan) -> list[SceneLine]:
    """Return a line for each particle: successful, or not."""
    paths = object_paths(plan.trajectories, carried_point(scene))
    return [
        SceneLine(path, _FREE if done else _COLLIDING)
        for path, done in zip(paths, plan.good, strict=True)
    ]


def draw_before_and_after(scenes: Sequence[Scene], path: Path) -> None:
    """Draw the particles of each scene before and after adaptation, and write a PNG (Fig. 3).

    Before are draws of the primitive conditioned on start, goal and via-points, as many as there
    are particles after.

    Args:
        scenes: one column each.
        path: of the image.
    """
    figure = Figure(figsize=(5.2 * len(scenes), 9.4), dpi=130, facecolor="white")
    FigureCanvasAgg(figure)
    width = 0.97 / len(scenes)
    for column, scene in enumerate(scenes):
        env = gym.make(environment_id(scene.task))
        plans = [
            _plan(PlannerPolicy.make("smp", scene.task, settings=settings), env, scene)
            for settings in (_BEFORE, {})
        ]
        env.close()
        lines = [_lines(scene, plan) for plan in plans]
        left = 0.03 + column * width
        both = [figure.add_axes((left, bottom, width - 0.006, 0.42)) for bottom in (0.5, 0.035)]
        for row, (axes, plan) in enumerate(zip(both, plans, strict=True)):
            paint_scene(axes, scene, lines[row], within=lines[1 - row])
            count, done = len(plan.good), int(plan.good.sum())
            axes.set_title(f"{done} of {count} succeed", fontsize=11, color=_DARK, y=-0.05)
        _share_limits(both)
        name = _TASK_TITLES[scene.task]
        figure.text(left + width / 2, 0.955, name, fontsize=16, weight="bold", ha="center")
    for height, name in ((0.71, "before adaptation"), (0.245, "after adaptation")):
        figure.text(0.01, height, name, fontsize=13, rotation=90, va="center")
    with replacing(path) as aside:
        figure.savefig(aside)


def _share_limits(pictures: Sequence[Any]) -> None:
    """Give pictures from one camera the same limits, wide enough for each."""
    for get, set_ in (("get_xlim", "set_xlim"), ("get_ylim", "set_ylim")):
        limits = np.array([getattr(axes, get)() for axes in pictures])
        for axes in pictures:
            getattr(axes, set_)(limits[:, 0].min(), limits[:, 1].max())


@dataclass(frozen=True)
class TwoModes:
    """Two modes of a plan, over an obstacle and beside it.

    Attributes:
        scene: what is planned in.
        plan: of all particles.
        over: the particle that passes over.
        beside: the particle that passes beside.
        distance: m, root mean squared over time, between the two paths of the carried point.
    """

    scene: Scene
    plan: Plan
    over: int
    beside: int
    distance: float


def _over_and_beside(scene: Scene, plan: Plan) -> list[TwoModes]:
    """Return all pairs of best good particles of two modes, over and beside some obstacle."""
    best = plan.best_of_modes
    best = best[plan.good[best] & (plan.modes.shares >= _LEAST_MODE_SHARE)]
    if plan.signatures is None or len(best) == 0:
        return []
    levels = plan.signatures[best, 1:].reshape(len(best), -1, 2)[..., 1]
    paths = object_paths(plan.trajectories[best], carried_point(scene))
    distances = rms_distances(paths, paths)
    return [
        TwoModes(scene, plan, int(best[a]), int(best[b]), float(distances[a, b]))
        for a, b in product(range(len(best)), repeat=2)
        if ((levels[a] == 1) & (levels[b] == 0)).any()
    ]


def find_two_modes(task: str, seeds: range, difficulty: str = "easy") -> TwoModes:
    """Return the two modes, over and beside an obstacle, that are farthest apart in some scenes.

    Each holds a tenth of the good particles at least, and its best one is executed with success in
    the physics.

    Args:
        task: one of `smp_gym.scene.TASKS`.
        seeds: of the scenes.
        difficulty: of the scenes.

    Raises:
        RuntimeError: no scene has two such modes.
    """
    env = gym.make(environment_id(task))
    policy = PlannerPolicy.make("smp", task)
    found: list[TwoModes] = []
    for seed in seeds:
        scene = sample_scene(task, difficulty, seed)
        found += _over_and_beside(scene, _plan(policy, env, scene))
    for pair in sorted(found, key=lambda pair: -pair.distance):
        executed = (
            rollout(env, policy.track(pair.plan, particle), scene=pair.scene).success
            for particle in (pair.over, pair.beside)
        )
        if all(executed):
            env.close()
            return pair
    env.close()
    raise RuntimeError(f"{task}: no scene of {seeds} is passed over and beside an obstacle")


def _filming(scene: Scene, camera: Mapping[str, Any]) -> gym.Env[Any, Any]:
    """Return an environment of a scene's task that renders."""
    width, height = FRAME_SIZE
    return gym.make(
        environment_id(scene.task),
        render_mode="rgb_array",
        width=width,
        height=height,
        camera=camera,
    )


def _film(
    env: gym.Env[Any, Any], scene: Scene, track: Track, video: Path, cells: Sequence[Any]
) -> bool:
    """Execute a trajectory, write a video, and show some pictures, from the first to the last.

    Returns:
        Whether it succeeded.
    """
    recorder = FrameRecorder()
    played = rollout(env, track, scene=scene, recorders=(recorder,))
    frames = recorder.frames
    write_video(frames, video)
    chosen = np.linspace(0, len(frames) - 1, len(cells)).round().astype(int)
    for cell, index in zip(cells, chosen, strict=True):
        cell.imshow(frames[index])
        cell.set_axis_off()
    return played.success


def draw_two_modes(pair: TwoModes, stills: Path, videos: tuple[Path, Path]) -> tuple[bool, bool]:
    """Execute two modes; write a sheet of pictures and a video of each (Fig. 5 and 6).

    Args:
        pair: from `find_two_modes`.
        stills: path of the sheet.
        videos: paths of the videos, over and beside.

    Returns:
        Whether each was executed with success.
    """
    figure = Figure(figsize=(19.5, 5.9), dpi=110, facecolor="white")
    FigureCanvasAgg(figure)
    env = _filming(pair.scene, _FAR_CAMERA)
    policy = PlannerPolicy.make("smp", pair.scene.task)
    done = []
    axes = figure.add_axes((0.0, 0.02, 0.245, 0.9))
    paths = object_paths(pair.plan.trajectories, carried_point(pair.scene))
    lines = [SceneLine(path, _FAINT) for path in paths[pair.plan.good]]
    for particle, color in zip((pair.over, pair.beside), _MODES, strict=True):
        lines.append(SceneLine(paths[particle], color, 3.2, rimmed=True))
    paint_scene(axes, pair.scene, lines)
    rows = (("over", pair.over, videos[0]), ("beside", pair.beside, videos[1]))
    for row, (name, particle, video) in enumerate(rows):
        size = 0.75 / _STILLS
        cells = [
            figure.add_axes((0.25 + k * size, 0.49 - 0.47 * row, size - 0.003, 0.44))
            for k in range(_STILLS)
        ]
        done.append(_film(env, pair.scene, policy.track(pair.plan, particle), video, cells))
        figure.text(0.252, 0.94 - 0.47 * row, name, fontsize=13, weight="bold", color=_MODES[row])
    env.close()
    figure.text(0.01, 0.945, _TASK_TITLES[pair.scene.task], fontsize=15, weight="bold")
    with replacing(stills) as aside:
        figure.savefig(aside)
    return done[0], done[1]


def modulated_scene() -> Scene:
    """Return the scene of Fig. 4: a new start, both ends moved, obstacles on both routes.

    The left pad stands nearer to the middle, by `SHIFT`, the right one as high as a pad can.
    """
    pose = end_effector_pose(np.array(START_CONFIGURATION))
    start = inverse_kinematics(
        pose[:3, 3] + _START_SHIFT, pose[:3, :3], seed=np.array(START_CONFIGURATION)
    )
    (x, y, z), (right_x, right_y, _) = NOMINAL_PADS
    pads = ((x, y - SHIFT, z), (right_x, right_y, PAD_DEPTH))
    return Scene(
        task="DoubleSidedPlacement",
        start=tuple(start.tolist()),
        manipulated=ManipulatedObject(),
        goals=tuple(Goal(kind="pad", position=pad) for pad in pads),
        obstacles=_OBSTACLES,
    )


_OBSTACLES = (
    Obstacle(shape="cylinder", position=(0.47, 0.15, 0.15), size=(0.03, 0.03, 0.15)),
    Obstacle(shape="box", position=(0.58, 0.20, 0.12), size=(0.03, 0.04, 0.12)),
    Obstacle(shape="cylinder", position=(0.44, -0.23, 0.19), size=(0.035, 0.035, 0.19)),
    Obstacle(shape="box", position=(0.57, -0.26, 0.13), size=(0.04, 0.03, 0.13)),
    Obstacle(shape="sphere", position=(0.42, -0.40, 0.55), size=(0.05, 0.05, 0.05)),
)
"""Obstacles of Fig. 4."""


def draw_two_sides(stills: Path, videos: tuple[Path, Path], seed: int = 0) -> tuple[bool, bool]:
    """Plan in `modulated_scene`, execute the best particle of each side, and draw both (Fig. 4).

    Args:
        stills: path of the sheet.
        videos: paths of the videos, left and right.
        seed: of the policy.

    Returns:
        Whether each side was executed with success.

    Raises:
        RuntimeError: no good particle on one of the sides.
    """
    scene = modulated_scene()
    env = _filming(scene, _FRONT_CAMERA)
    policy = PlannerPolicy.make("smp", scene.task, seed=seed)
    plan = _plan(policy, env, scene)
    assert plan.signatures is not None
    assert plan.ranks is not None
    sides = plan.signatures[:, 0]
    figure = Figure(figsize=(19.5, 12.0), dpi=110, facecolor="white")
    FigureCanvasAgg(figure)
    paths = object_paths(plan.trajectories, carried_point(scene))
    shipped = object_paths(Demonstrations.load(scene.task).configurations, carried_point(scene))
    taught = [SceneLine(path, _DARK, 1.1, dashed=True) for path in shipped]
    bare = scene.model_copy(update={"obstacles": ()})
    paint_scene(figure.add_axes((0.0, 0.47, 0.5, 0.46)), bare, taught, _FRONT_AZIMUTH)
    done, best = [], []
    for side, name in enumerate(("left", "right")):
        candidates = np.flatnonzero(plan.good & (sides == side))
        if len(candidates) == 0:
            raise RuntimeError(f"no good particle goes to the {name} pad")
        best.append(int(candidates[plan.ranks[candidates].argmin()]))
        cells = [
            figure.add_axes((0.005 + 0.2 * k, 0.235 - 0.225 * side, 0.19, 0.205))
            for k in range(_STILLS)
        ]
        done.append(_film(env, scene, policy.track(plan, best[side]), videos[side], cells))
        figure.text(
            0.008, 0.443 - 0.225 * side, name, fontsize=13, weight="bold", color=_MODES[side]
        )
    env.close()
    lines = _lines(scene, plan)
    lines += [
        SceneLine(paths[p], color, 3.4, rimmed=True) for p, color in zip(best, _MODES, strict=True)
    ]
    paint_scene(figure.add_axes((0.5, 0.47, 0.5, 0.46)), scene, lines, _FRONT_AZIMUTH)
    figure.text(0.02, 0.955, "demonstrations, new start and new ends", fontsize=15, weight="bold")
    figure.text(0.52, 0.955, "adapted", fontsize=15, weight="bold")
    figure.legend(
        handles=[
            Line2D(
                [],
                [],
                color=_FREE,
                lw=1.5,
                label=f"particles that succeed ({int(plan.good.sum())})",
            ),
            Line2D([], [], color=_MODES[0], lw=3.4, label="executed, left"),
            Line2D([], [], color=_MODES[1], lw=3.4, label="executed, right"),
        ],
        loc="upper right",
        frameon=False,
        fontsize=11,
    )
    with replacing(stills) as aside:
        figure.savefig(aside)
    return done[0], done[1]
