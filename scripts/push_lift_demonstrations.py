"""The scripted demonstrator of PushLiftBox; `record_demonstrations.py` calls it.

Each demonstration begins in another configuration and finds the box in another place. It comes to
rest behind the box, pushes it, comes to rest again, closes the hand and lifts the box. The time in
which the hand closes is not part of what is recorded: a demonstration is the arm's movement, and
the gripper's command at each phase of it.
"""

from __future__ import annotations

import gymnasium
import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from scipy.interpolate import make_interp_spline
from scipy.spatial.transform import Rotation

import smp_gym  # noqa: F401  (registers the environments)
from smp_gym.datasets.demonstrations import DEMONSTRATION_SAMPLES, Demonstrations, resample
from smp_gym.observation import CONTROL_PERIOD, DecodedObservation, decode
from smp_gym.robot.kinematics import JOINT_VELOCITY, end_effector_pose, inverse_kinematics
from smp_gym.scene import Goal, ManipulatedObject, Scene
from smp_gym.tasks.push_lift_box import rules as task

TASK = "PushLiftBox"
SEED = 0
COUNT = 7

SPEED_LIMIT = 0.9
"""Share of the joint velocity limits that a demonstrator uses at most."""

DURATION = (10.5, 12.0)
"""s, of the movement without the time in which the hand closes."""

BEHIND_SAMPLE, GRASP_SAMPLE = 84, 124
"""Samples of a movement at which the hand rests behind the box, and at the end of the push."""

CLOSING_STEPS = 20
"""Environment steps in which the hand closes."""

LIFTED_TILT = 0.35
"""rad, of the hand below the horizontal at the target."""

FloatArray = NDArray[np.float64]


def draw_scene(rng: np.random.Generator) -> Scene:
    """Return a scene without obstacles; the target is nearly the same in all."""
    size = ManipulatedObject().size
    spread = 0.8 * np.asarray(task.START_SPREAD)
    start = np.asarray(task.START_CONFIGURATION) + rng.uniform(-spread, spread)
    radius, bearing = rng.uniform(*task.BOX_RADIUS), rng.uniform(*task.BOX_BEARING)
    position = (float(radius * np.cos(bearing)), float(radius * np.sin(bearing)), size[2])
    yaw = float(bearing + rng.uniform(-task.BOX_TURN, task.BOX_TURN))
    far, turn, high = (
        np.mean(region) + rng.normal(0.0, 0.01)
        for region in (task.TARGET_RADIUS, task.TARGET_BEARING, task.TARGET_HEIGHT)
    )
    target = (float(far * np.cos(turn)), float(far * np.sin(turn)), float(high))
    a, b, c, d, e, f = start.tolist()
    return Scene(
        task=TASK,
        start=(a, b, c, d, e, f),
        manipulated=ManipulatedObject(position=position, yaw=yaw),
        goals=(Goal(kind="lift", position=target),),
    )


def lifted_configuration(target: FloatArray, near: FloatArray, tilt: float) -> FloatArray:
    """Return the (6,) rad that hold the box at a target, the hand pointing away from the base."""
    turn = Rotation.from_euler("zy", [np.arctan2(target[1], target[0]), tilt]).as_matrix()
    return inverse_kinematics(target - turn @ task.HELD_OBJECT_POSE[:3, 3], turn, seed=near)


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
    behind, grasp = BEHIND_SAMPLE, GRASP_SAMPLE
    phase = np.linspace(0.0, 1.0, grasp - behind + 1)
    shares = phase**3 * (10.0 - 15.0 * phase + 6.0 * phase**2)
    push: list[FloatArray] = []
    for pose in task.push_poses(np.array(box.position), box.yaw, shares)[::-1]:
        near = push[-1] if push else PUSHED_NEAR
        push.append(inverse_kinematics(pose[:3, 3], pose[:3, :3], seed=near))
    push.reverse()
    target = np.array(scene.goals[0].position)
    end = lifted_configuration(target, push[-1], LIFTED_TILT + rng.normal(0.0, 0.03))
    approach = (start + push[0]) / 2 + rng.normal(0.0, 0.06, 6)
    lift = (push[-1] + end) / 2 + rng.normal(0.0, 0.06, 6)
    return np.concatenate(
        [
            _stretch(start, approach, push[0], behind + 1)[:-1],
            np.array(push)[:-1],
            _stretch(push[-1], lift, end, last - grasp + 1),
        ]
    )


PUSHED_NEAR = np.array([-1.26, 4.2, 0.9, 0.0, 1.7, 0.0])
"""(6,) rad, a configuration near those at the end of a push."""


class _Demonstrator:
    """Plays targets in an environment and remembers what the arm did."""

    def __init__(self, env: gymnasium.Env, scene: Scene) -> None:
        self.env = env
        observation, self.info = env.reset(options={"scene": scene})
        self.state: DecodedObservation = decode(observation, TASK)
        self.done = False
        self.measured = [self.state.robot.configuration]

    def step(self, target: FloatArray, gripper: float, *, keep: bool = True) -> None:
        if self.done:
            return
        rate = (target - self.state.robot.reference) / (CONTROL_PERIOD * JOINT_VELOCITY)
        action = np.append(np.clip(rate, -1.0, 1.0), gripper).astype(np.float32)
        observation, _, terminated, truncated, self.info = self.env.step(action)
        self.state = decode(observation, TASK)
        self.done = terminated or truncated
        if keep:
            self.measured.append(self.state.robot.configuration)


def _held_pose(state: DecodedObservation) -> FloatArray:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_quat(state.object.quaternion).as_matrix()
    pose[:3, 3] = state.object.position
    return np.asarray(np.linalg.inv(end_effector_pose(state.robot.configuration)) @ pose)


def record(console: Console) -> Demonstrations:
    """Draw, execute and record all demonstrations.

    Raises:
        RuntimeError: one of them did not succeed.
    """
    rng = np.random.default_rng(SEED)
    env = gymnasium.make(f"smp_gym/{TASK}-v0", difficulty="none")
    table = Table("demonstration", "duration, s", "speed, % of limit", "outcome")
    trajectories, durations, scenes, fingers, held = [], [], [], [], []
    for number in range(COUNT):
        scene = draw_scene(rng)
        movement = scripted_movement(scene, rng)
        duration = round(rng.uniform(*DURATION) / CONTROL_PERIOD) * CONTROL_PERIOD
        speed = np.abs(np.diff(movement, axis=0)).max(axis=0) * (len(movement) - 1) / duration
        steps = round(duration / CONTROL_PERIOD)
        targets = resample(movement, steps + 1)[1:]
        grasp = round(GRASP_SAMPLE / (DEMONSTRATION_SAMPLES - 1) * steps)
        player = _Demonstrator(env, scene)
        for step, target in enumerate(targets, start=1):
            player.step(target, -1.0 if step <= grasp else 1.0)
            if step == grasp:
                for _ in range(CLOSING_STEPS):
                    player.step(target, 1.0, keep=False)
                fingers.append(player.state.robot.finger_angles)
                held.append(_held_pose(player.state))
        outcome = "success" if player.info["is_success"] else player.info["failure"]
        share = float((speed / JOINT_VELOCITY).max())
        table.add_row(str(number + 1), f"{duration:.2f}", f"{100 * share:.0f}", outcome)
        if outcome != "success" or share > SPEED_LIMIT:
            console.print(table)
            raise RuntimeError(f"demonstration {number + 1}: {outcome}, speed {share:.2f}")
        # Success ends an episode a little before the movement does: the rest is as commanded.
        kept = np.array(player.measured)
        kept = np.concatenate([kept, targets[len(kept) - 1 :]])
        trajectories.append(resample(kept))
        durations.append(duration)
        scenes.append(scene)
    env.close()
    console.print(table)
    closed = np.arange(DEMONSTRATION_SAMPLES) >= GRASP_SAMPLE
    return Demonstrations(
        task=TASK,
        configurations=np.array(trajectories),
        gripper=np.tile(closed.astype(np.float64), (COUNT, 1)),
        durations=np.array(durations),
        scenes=tuple(scenes),
        metadata={
            "recorded_by": "scripts/record_demonstrations.py",
            "seed": SEED,
            "finger_angles": np.mean(fingers, axis=0).tolist(),
            "object_in_hand": np.mean(held, axis=0).tolist(),
            "push_samples": [BEHIND_SAMPLE, GRASP_SAMPLE],
        },
    )
