"""Record the demonstrations that ship with the package: a scripted demonstrator in the physics.

Each demonstration takes a way of its own (height, curvature, tempo, posture of the wrist, place of
release), is executed in the environment, and is recorded from what the arm does there. Nothing is
written unless every one of them ends in success.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import gymnasium
import numpy as np
import typer
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from scipy.interpolate import make_interp_spline
from scipy.spatial.transform import Rotation

import smp_gym  # noqa: F401  (registers the environments)
from smp_gym.datasets.demonstrations import DEMONSTRATION_SAMPLES, Demonstrations, resample
from smp_gym.observation import CONTROL_PERIOD, decode
from smp_gym.robot.kinematics import (
    GRASP_CENTER,
    JOINT_VELOCITY,
    end_effector_pose,
    inverse_kinematics,
)
from smp_gym.scene import TASKS, Configuration, Goal, ManipulatedObject, Scene
from smp_gym.tasks.double_sided_placement import rules as double_sided_placement
from smp_gym.tasks.placement import rules as placement

SEED = 0

DURATION = (10.5, 13.0)
"""Seconds from the start of Placement to the release."""

SPEED_LIMIT = 0.9
"""Share of the joint velocity limits that a demonstrator uses at most."""

RELEASE_STEPS = 60
"""Environment steps that the object is given to come to rest."""

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Script:
    """What the demonstrator does in a task.

    Attributes:
        task: its name.
        start: (6,) rad.
        goals: of the scene.
        ways: index of the goal that each demonstration goes to.
        release_height: m, of the object's centre above the goal when it is let go.
        tilt: rad, of the hand below the horizontal then.
        duration: s, range of the time from the start to the release.
        lift: m, range of the height of the way's middle above the straight line.
    """

    task: str
    start: Configuration
    goals: tuple[Goal, ...]
    ways: tuple[int, ...]
    release_height: float
    tilt: float
    duration: tuple[float, float]
    lift: tuple[float, float]

    @property
    def scene(self) -> Scene:
        """The scene in which all demonstrations are given."""
        return Scene(
            task=self.task,
            start=self.start,
            manipulated=ManipulatedObject(),
            goals=self.goals,
        )


PLACEMENT = Script(
    task="Placement",
    start=placement.START_CONFIGURATION,
    goals=(Goal(position=placement.NOMINAL_BIN),),
    ways=(0,) * 7,
    release_height=placement.RELEASE_HEIGHT,
    tilt=placement.RELEASE_TILT,
    duration=DURATION,
    lift=(0.04, 0.14),
)
DOUBLE_SIDED_PLACEMENT = Script(
    task="DoubleSidedPlacement",
    start=double_sided_placement.START_CONFIGURATION,
    goals=tuple(Goal(kind="pad", position=p) for p in double_sided_placement.NOMINAL_PADS),
    ways=(0,) * 7 + (1,) * 7,
    release_height=ManipulatedObject().size[2] + double_sided_placement.RELEASE_GAP,
    tilt=double_sided_placement.TILT,
    duration=(8.0, 10.0),
    lift=(0.03, 0.11),
)
SCRIPTS = {script.task: script for script in (PLACEMENT, DOUBLE_SIDED_PLACEMENT)}


@dataclass(frozen=True)
class Recording:
    """What was measured in one execution: (M, 6) rad, (4,) rad, and the last step's info."""

    configurations: FloatArray
    finger_angles: FloatArray
    info: dict[str, Any]


def hand_rotation(yaw: float, tilt: float) -> Rotation:
    """Return the hand pointing along `yaw`, `tilt` rad below the horizontal, opening sideways."""
    approach = np.array([np.cos(yaw) * np.cos(tilt), np.sin(yaw) * np.cos(tilt), -np.sin(tilt)])
    opening = np.array([-np.sin(yaw), np.cos(yaw), 0.0])
    return Rotation.from_matrix(np.stack([approach, opening, np.cross(approach, opening)], axis=1))


def hold(center: FloatArray, rotation: Rotation, near: FloatArray) -> FloatArray:
    """Return the (6,) configuration with the held object's centre at `center`."""
    matrix = rotation.as_matrix()
    wrist = center - matrix @ np.asarray(GRASP_CENTER)
    return inverse_kinematics(wrist, matrix, seed=near)


def held_height(movement: FloatArray) -> float:
    """Return the greatest height, m, of the held object's centre on the way."""
    pose = end_effector_pose(movement)
    return float((pose[:, 2, :3] @ np.asarray(GRASP_CENTER) + pose[:, 2, 3]).max())


def scripted_movement(
    rng: np.random.Generator, script: Script = PLACEMENT, way: int = 0
) -> FloatArray:
    """Return one way of carrying the object from the start over goal `way`, (200, 6) rad.

    The joints follow the minimum-jerk curve (a quintic spline, at rest at both ends) through two
    configurations between start and release.
    """
    start = np.asarray(script.start, np.float64)
    pose = end_effector_pose(start)
    turn = Rotation.from_matrix(pose[:3, :3])
    origin = pose[:3, :3] @ np.asarray(GRASP_CENTER) + pose[:3, 3]
    above = np.array([0.0, 0.0, script.release_height + rng.uniform(-0.004, 0.012)])
    release = np.asarray(script.goals[way].position) + above
    release[:2] += rng.normal(0.0, 0.006, 2)
    last_turn = hand_rotation(
        np.arctan2(release[1], release[0]) + rng.normal(0.0, 0.04),
        script.tilt + rng.normal(0.0, 0.03),
    )
    between = (turn.inv() * last_turn).as_rotvec()
    radius = np.hypot(origin[0], origin[1]), np.hypot(release[0], release[1])
    angle = np.arctan2(origin[1], origin[0]), np.arctan2(release[1], release[0])
    lift, reach, skew = rng.uniform(*script.lift), rng.normal(0.0, 0.025), rng.normal(0.0, 0.03)

    phases, ways = [0.0], [start]
    for phase in (1 / 3, 2 / 3):
        part = phase + skew
        bow = np.sin(np.pi * part)
        r = radius[0] + part * (radius[1] - radius[0]) + reach * bow
        a = angle[0] + part * (angle[1] - angle[0])
        z = origin[2] + part * (release[2] - origin[2]) + lift * bow
        wrist = turn * Rotation.from_rotvec(part * between)
        wrist = wrist * Rotation.from_rotvec(rng.normal(0.0, 0.04, 3))
        ways.append(hold(np.array([r * np.cos(a), r * np.sin(a), z]), wrist, ways[-1]))
        phases.append(phase + rng.normal(0.0, 0.015))
    phases.append(1.0)
    ways.append(hold(release, last_turn, ways[-1]))
    rest = [(1, np.zeros(6)), (2, np.zeros(6))]
    curve = make_interp_spline(phases, np.array(ways), k=5, bc_type=(rest, rest))
    movement: FloatArray = curve(np.linspace(0.0, 1.0, DEMONSTRATION_SAMPLES))
    return movement


def execute(env: gymnasium.Env, scene: Scene, movement: FloatArray, duration: float) -> Recording:
    """Play a movement in an environment, open the hand at its end and wait for the outcome."""
    observation, info = env.reset(options={"scene": scene})
    steps = round(duration / CONTROL_PERIOD)
    targets = resample(movement, steps + 1)[1:]
    state = decode(observation, scene.task).robot
    fingers, measured = state.finger_angles, [state.configuration]
    for target in (*targets, *np.repeat(targets[-1:], RELEASE_STEPS, axis=0)):
        action = np.zeros(7, np.float32)
        rate = (target - state.reference) / (CONTROL_PERIOD * JOINT_VELOCITY)
        action[:6] = np.clip(rate, -1.0, 1.0)
        action[6] = -1.0 if len(measured) > steps else 0.0
        observation, _, terminated, truncated, info = env.step(action)
        state = decode(observation, scene.task).robot
        measured.append(state.configuration)
        if terminated or truncated:
            break
    return Recording(np.array(measured[: steps + 1]), fingers, info)


def record(script: Script, console: Console) -> Demonstrations:
    """Draw, execute and record all demonstrations of a task.

    Raises:
        RuntimeError: one of them did not succeed.
    """
    rng = np.random.default_rng(SEED)
    scene, count = script.scene, len(script.ways)
    env = gymnasium.make(f"smp_gym/{script.task}-v0")
    table = Table("demonstration", "duration, s", "highest, m", "speed, % of limit", "outcome")
    trajectories, durations, fingers = [], [], []
    for number, way in enumerate(script.ways):
        movement = scripted_movement(rng, script, way)
        duration = rng.uniform(*script.duration)
        duration = round(duration / CONTROL_PERIOD) * CONTROL_PERIOD
        speed = np.abs(np.diff(movement, axis=0)).max(axis=0) * (len(movement) - 1) / duration
        recording = execute(env, scene, movement, duration)
        outcome = "success" if recording.info["is_success"] else recording.info["failure"]
        share = float((speed / JOINT_VELOCITY).max())
        table.add_row(
            str(number + 1),
            f"{duration:.2f}",
            f"{held_height(movement):.3f}",
            f"{100 * share:.0f}",
            outcome,
        )
        if outcome != "success" or share > SPEED_LIMIT:
            console.print(table)
            raise RuntimeError(f"demonstration {number + 1}: {outcome}, speed {share:.2f}")
        trajectories.append(resample(recording.configurations))
        durations.append(duration)
        fingers.append(recording.finger_angles)
    env.close()
    console.print(table)
    gripper = np.ones((count, DEMONSTRATION_SAMPLES))
    gripper[:, -1] = 0.0
    return Demonstrations(
        task=script.task,
        configurations=np.array(trajectories),
        gripper=gripper,
        durations=np.array(durations),
        scenes=(scene,) * count,
        metadata={
            "recorded_by": "scripts/record_demonstrations.py",
            "seed": SEED,
            "finger_angles": np.mean(fingers, axis=0).tolist(),
        },
    )


def main(
    out: Annotated[
        Path | None,
        typer.Option(help="File to write; default envs_assets/demonstrations/TASK.npz."),
    ] = None,
    task: Annotated[str, typer.Option(help=f"One of {', '.join(TASKS)}.")] = PLACEMENT.task,
) -> None:
    """Record the demonstrations of a task; refuse to write unless all of them succeed."""
    console = Console()
    out = out or Path(f"envs_assets/demonstrations/{task}.npz")
    try:
        demonstrations = _recorder(task)(console)
    except RuntimeError as error:
        console.print(f"nothing written: {error}")
        raise typer.Exit(1) from error
    demonstrations.save(out)
    console.print(f"wrote {out}")


def _recorder(task: str) -> Callable[[Console], Demonstrations]:
    if task in SCRIPTS:
        return partial(record, SCRIPTS[task])
    if task == "DrawS":
        import draw_s_demonstrations

        return draw_s_demonstrations.record
    if task == "PushLiftBox":
        import push_lift_demonstrations

        return push_lift_demonstrations.record
    raise typer.BadParameter(f"task must be one of {', '.join(TASKS)}; got {task!r}")


if __name__ == "__main__":
    typer.run(main)
