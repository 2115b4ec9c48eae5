"""The scripted demonstrator of PushLiftBox.

Each demonstration begins in another configuration and finds the box in another place. It comes to
rest behind the box, pushes it, comes to rest again, closes the hand and lifts the box. The time in
which the hand closes is not part of what is recorded: a demonstration is the arm's movement, and
the gripper's command at each phase of it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import gymnasium
import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.spatial.transform import Rotation

from smp_gym.arrays import FloatArray
from smp_gym.datasets.demonstrations import DEMONSTRATION_SAMPLES, Demonstrations, resample
from smp_gym.observation import CONTROL_PERIOD, DecodedObservation, decode
from smp_gym.robot.kinematics import end_effector_pose, inverse_kinematics
from smp_gym.scene import Goal, ManipulatedObject, Scene
from smp_gym.tasks.performance import Performance, Report, collect, draw_duration, measured, perform
from smp_gym.tasks.push_lift_box import rules

__all__ = ["demonstrate", "scripted_movement"]

_TASK = "PushLiftBox"
_SEED = 0
_COUNT = 7

_DURATION = (10.5, 12.0)
"""s, of the movement without the time in which the hand closes."""

_BEHIND_SAMPLE, _GRASP_SAMPLE = 84, 124
"""Samples of a movement at which the hand rests behind the box, and at the end of the push."""

_CLOSING_STEPS = 20
"""Environment steps in which the hand closes."""

_LIFTED_TILT = 0.35
"""rad, of the hand below the horizontal at the target."""

_PUSHED_NEAR = np.array([-1.26, 4.2, 0.9, 0.0, 1.7, 0.0])
"""(6,) rad, a configuration near those at the end of a push."""


def _draw_scene(rng: np.random.Generator) -> Scene:
    """Return a scene without obstacles; the target is nearly the same in all."""
    size = ManipulatedObject().size
    spread = 0.8 * np.asarray(rules.START_SPREAD)
    start = np.asarray(rules.START_CONFIGURATION) + rng.uniform(-spread, spread)
    radius, bearing = rng.uniform(*rules.BOX_RADIUS), rng.uniform(*rules.BOX_BEARING)
    position = (float(radius * np.cos(bearing)), float(radius * np.sin(bearing)), size[2])
    yaw = float(bearing + rng.uniform(-rules.BOX_TURN, rules.BOX_TURN))
    far, turn, high = (
        np.mean(region) + rng.normal(0.0, 0.01)
        for region in (rules.TARGET_RADIUS, rules.TARGET_BEARING, rules.TARGET_HEIGHT)
    )
    target = (float(far * np.cos(turn)), float(far * np.sin(turn)), float(high))
    a, b, c, d, e, f = start.tolist()
    return Scene(
        task=_TASK,
        start=(a, b, c, d, e, f),
        manipulated=ManipulatedObject(position=position, yaw=yaw),
        goals=(Goal(kind="lift", position=target),),
    )


def _lifted_configuration(target: FloatArray, near: FloatArray, tilt: float) -> FloatArray:
    """Return the (6,) rad that hold the box at a target, the hand pointing away from the base."""
    turn = Rotation.from_euler("zy", [np.arctan2(target[1], target[0]), tilt]).as_matrix()
    return inverse_kinematics(target - turn @ rules.HELD_OBJECT_POSE[:3, 3], turn, seed=near)


def _stretch(begin: FloatArray, middle: FloatArray, end: FloatArray, samples: int) -> FloatArray:
    """Return the minimum-jerk curve (samples, 6) through three configurations, at rest at ends."""
    rest = [(1, np.zeros(6)), (2, np.zeros(6))]
    curve = make_interp_spline((0.0, 0.5, 1.0), [begin, middle, end], k=5, bc_type=(rest, rest))
    stretch: FloatArray = curve(np.linspace(0.0, 1.0, samples))
    return stretch


def scripted_movement(scene: Scene, rng: np.random.Generator) -> FloatArray:
    """Return the movement of one demonstration, (200, 6) rad."""
    start, box = np.array(scene.start), scene.manipulated
    assert box is not None
    assert box.position is not None
    last = DEMONSTRATION_SAMPLES - 1
    behind, grasp = _BEHIND_SAMPLE, _GRASP_SAMPLE
    phase = np.linspace(0.0, 1.0, grasp - behind + 1)
    shares = phase**3 * (10.0 - 15.0 * phase + 6.0 * phase**2)
    push: list[FloatArray] = []
    for pose in rules.push_poses(np.array(box.position), box.yaw, shares)[::-1]:
        near = push[-1] if push else _PUSHED_NEAR
        push.append(inverse_kinematics(pose[:3, 3], pose[:3, :3], seed=near))
    push.reverse()
    target = np.array(scene.goals[0].position)
    end = _lifted_configuration(target, push[-1], _LIFTED_TILT + rng.normal(0.0, 0.03))
    approach = (start + push[0]) / 2 + rng.normal(0.0, 0.06, 6)
    lift = (push[-1] + end) / 2 + rng.normal(0.0, 0.06, 6)
    return np.concatenate(
        [
            _stretch(start, approach, push[0], behind + 1)[:-1],
            np.array(push)[:-1],
            _stretch(push[-1], lift, end, last - grasp + 1),
        ]
    )


def _held_pose(state: DecodedObservation) -> FloatArray:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_quat(state.object.quaternion).as_matrix()
    pose[:3, 3] = state.object.position
    return np.asarray(np.linalg.inv(end_effector_pose(state.robot.configuration)) @ pose)


def demonstrate(report: Report) -> Demonstrations:
    """Draw, execute and record all demonstrations.

    Raises:
        RuntimeError: one of them did not succeed.
    """
    held: list[FloatArray] = []
    closed = np.arange(DEMONSTRATION_SAMPLES) >= _GRASP_SAMPLE
    recorded = collect(
        _performances(held),
        closed.astype(np.float64),
        report,
        seed=_SEED,
        push_samples=[_BEHIND_SAMPLE, _GRASP_SAMPLE],
    )
    in_hand = np.mean(held, axis=0).tolist()
    return replace(recorded, metadata={**recorded.metadata, "object_in_hand": in_hand})


def _performances(held: list[FloatArray]) -> Iterator[Performance]:
    """Yield the performances; to `held` is added each one's pose (4, 4) of the box in the hand."""
    rng = np.random.default_rng(_SEED)
    env = gymnasium.make(f"smp_gym/{_TASK}-v0", difficulty="none")
    for _ in range(_COUNT):
        scene = _draw_scene(rng)
        movement = scripted_movement(scene, rng)
        duration = draw_duration(_DURATION, rng)
        steps = round(duration / CONTROL_PERIOD)
        targets = resample(movement, steps + 1)[1:]
        grasp = round(_GRASP_SAMPLE / (DEMONSTRATION_SAMPLES - 1) * steps)
        closing = np.repeat(targets[grasp - 1][None], _CLOSING_STEPS, axis=0)
        played = np.concatenate([targets[:grasp], closing, targets[grasp:]])
        gripper = np.where(np.arange(len(played)) < grasp, -1.0, 1.0)
        moments = perform(env, scene, played, gripper)
        closed = grasp + _CLOSING_STEPS
        state = decode(moments[closed].observation, _TASK)
        held.append(_held_pose(state))
        # Success ends an episode a little before the movement does: the rest is as commanded.
        kept = measured([*moments[: grasp + 1], *moments[closed + 1 :]])
        kept = np.concatenate([kept, targets[len(kept) - 1 :]])
        fingers = state.robot.finger_angles
        yield Performance(scene, movement, duration, kept, fingers, moments[-1].info)
    env.close()
