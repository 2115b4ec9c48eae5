"""The scripted demonstrator of tasks that carry the object in the hand to a goal.

Each demonstration takes a movement of its own (height, curvature, tempo, posture of the wrist,
place of release).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import gymnasium
import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.spatial.transform import Rotation

from smp_gym.arrays import FloatArray
from smp_gym.datasets.demonstrations import DEMONSTRATION_SAMPLES, Demonstrations, resample
from smp_gym.observation import CONTROL_PERIOD, state_field
from smp_gym.robot.kinematics import GRASP_CENTER, end_effector_pose, inverse_kinematics
from smp_gym.scene import Configuration, Goal, ManipulatedObject, Scene
from smp_gym.tasks.performance import Performance, Report, collect, draw_duration, measured, perform

__all__ = ["Script"]

_SEED = 0

_RELEASE_STEPS = 60
"""Environment steps that the object is given to come to rest."""


@dataclass(frozen=True)
class Script:
    """The demonstrator's movements in a task, and the settings that they follow.

    Attributes:
        task: its name.
        start: (6,) rad.
        goals: of the scene.
        targets: index of the goal that each demonstration goes to.
        release_height: m, of the object's centre above the goal when it is let go.
        tilt: rad, of the hand below the horizontal then.
        duration: s, range of the time from the start to the release.
        lift: m, range of the height of the movement's middle above the straight line.
    """

    task: str
    start: Configuration
    goals: tuple[Goal, ...]
    targets: tuple[int, ...]
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

    def movement(self, rng: np.random.Generator, target: int = 0) -> FloatArray:
        """Return one movement of the object from the start over goal `target`, (200, 6) rad.

        The joints follow the minimum-jerk curve (a quintic spline, at rest at both ends) through
        two configurations between start and release.
        """
        start = np.asarray(self.start, np.float64)
        pose = end_effector_pose(start)
        turn = Rotation.from_matrix(pose[:3, :3])
        origin = pose[:3, :3] @ np.asarray(GRASP_CENTER) + pose[:3, 3]
        above = np.array([0.0, 0.0, self.release_height + rng.uniform(-0.004, 0.012)])
        release = np.asarray(self.goals[target].position) + above
        release[:2] += rng.normal(0.0, 0.006, 2)
        last_turn = _hand_rotation(
            np.arctan2(release[1], release[0]) + rng.normal(0.0, 0.04),
            self.tilt + rng.normal(0.0, 0.03),
        )
        between = (turn.inv() * last_turn).as_rotvec()
        radius = np.hypot(origin[0], origin[1]), np.hypot(release[0], release[1])
        angle = np.arctan2(origin[1], origin[0]), np.arctan2(release[1], release[0])
        lift, reach, skew = rng.uniform(*self.lift), rng.normal(0.0, 0.025), rng.normal(0.0, 0.03)

        phases, knots = [0.0], [start]
        for phase in (1 / 3, 2 / 3):
            part = phase + skew
            bow = np.sin(np.pi * part)
            r = radius[0] + part * (radius[1] - radius[0]) + reach * bow
            a = angle[0] + part * (angle[1] - angle[0])
            z = origin[2] + part * (release[2] - origin[2]) + lift * bow
            wrist = turn * Rotation.from_rotvec(part * between)
            wrist = wrist * Rotation.from_rotvec(rng.normal(0.0, 0.04, 3))
            knots.append(_hold(np.array([r * np.cos(a), r * np.sin(a), z]), wrist, knots[-1]))
            phases.append(phase + rng.normal(0.0, 0.015))
        phases.append(1.0)
        knots.append(_hold(release, last_turn, knots[-1]))
        rest = [(1, np.zeros(6)), (2, np.zeros(6))]
        curve = make_interp_spline(phases, np.array(knots), k=5, bc_type=(rest, rest))
        movement: FloatArray = curve(np.linspace(0.0, 1.0, DEMONSTRATION_SAMPLES))
        return movement

    def record(self, report: Report) -> Demonstrations:
        """Draw, execute and record all demonstrations.

        Raises:
            RuntimeError: one of them did not succeed.
        """
        gripper = np.ones(DEMONSTRATION_SAMPLES)
        gripper[-1] = 0.0
        return collect(self._performances(), gripper, report, seed=_SEED)

    def _performances(self) -> Iterator[Performance]:
        rng, scene = np.random.default_rng(_SEED), self.scene
        env = gymnasium.make(f"smp_gym/{self.task}-v0")
        for target in self.targets:
            movement = self.movement(rng, target)
            yield _perform(env, scene, movement, draw_duration(self.duration, rng))
        env.close()


def _perform(
    env: gymnasium.Env, scene: Scene, movement: FloatArray, duration: float
) -> Performance:
    """Play a movement, open the hand at its end and wait for the outcome."""
    steps = round(duration / CONTROL_PERIOD)
    targets = resample(movement, steps + 1)[1:]
    released = np.repeat(targets[-1:], _RELEASE_STEPS, axis=0)
    gripper = np.repeat([0.0, -1.0], [steps, _RELEASE_STEPS])
    moments = perform(env, scene, np.concatenate([targets, released]), gripper)
    fingers = state_field(moments[0].observation, "finger_angles")
    kept = measured(moments[: steps + 1])
    return Performance(scene, movement, duration, kept, fingers, moments[-1].info)


def _hand_rotation(yaw: float, tilt: float) -> Rotation:
    """Return the hand pointing along `yaw`, `tilt` rad below the horizontal, opening sideways."""
    approach = np.array([np.cos(yaw) * np.cos(tilt), np.sin(yaw) * np.cos(tilt), -np.sin(tilt)])
    opening = np.array([-np.sin(yaw), np.cos(yaw), 0.0])
    return Rotation.from_matrix(np.stack([approach, opening, np.cross(approach, opening)], axis=1))


def _hold(center: FloatArray, rotation: Rotation, near: FloatArray) -> FloatArray:
    """Return the (6,) configuration with the held object's centre at `center`."""
    matrix = rotation.as_matrix()
    wrist = center - matrix @ np.asarray(GRASP_CENTER)
    return inverse_kinematics(wrist, matrix, seed=near)
