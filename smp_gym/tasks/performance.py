"""Performances: scripted movements, executed in the environment and recorded as demonstrations."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np

from smp_gym.arrays import FloatArray
from smp_gym.datasets.demonstrations import Demonstrations, resample
from smp_gym.observation import CONTROL_PERIOD, state_field
from smp_gym.robot.kinematics import JOINT_VELOCITY
from smp_gym.rollout import Moment, Waypoints, rollout
from smp_gym.scene import Scene

__all__ = [
    "SPEED_LIMIT",
    "Performance",
    "Report",
    "collect",
    "draw_duration",
    "measured",
    "perform",
]

SPEED_LIMIT = 0.9
"""Share of the joint velocity limits that a demonstrator uses at most."""

Report = Callable[[str], None]
"""Callback that takes the outcome of each performance, in one line."""


def draw_duration(bounds: tuple[float, float], rng: np.random.Generator) -> float:
    """Return a duration between bounds (s), a whole number of environment steps."""
    return round(rng.uniform(*bounds) / CONTROL_PERIOD) * CONTROL_PERIOD


def perform(
    env: gymnasium.Env,
    scene: Scene,
    targets: FloatArray,
    gripper: FloatArray,
    ends: Callable[[Moment], bool] | None = None,
) -> list[Moment]:
    """Return the moments of an episode in which the arm is led through targets.

    Args:
        env: of the scene's task.
        scene: in which to play.
        targets: (M, 6) rad, one a step.
        gripper: (M,) the gripper's action in each.
        ends: see `rollout`.
    """
    moments: list[Moment] = []
    rollout(
        env,
        Waypoints(targets, gripper),
        scene=scene,
        steps=len(targets),
        recorders=[moments.append],
        ends=ends,
    )
    return moments


def measured(moments: Iterable[Moment]) -> FloatArray:
    """Return the configurations (M, 6) rad of the arm at moments."""
    return np.array([state_field(moment.observation, "configuration") for moment in moments])


@dataclass(frozen=True)
class Performance:
    """One demonstration, executed.

    Attributes:
        scene: in which it was.
        movement: (T, 6) rad, as the script had it, at equal steps of phase.
        duration: s.
        configurations: (M, 6) rad, as measured.
        finger_angles: (4,) rad, with object or pen in the hand.
        info: of the last step.
    """

    scene: Scene
    movement: FloatArray
    duration: float
    configurations: FloatArray
    finger_angles: FloatArray
    info: dict[str, Any]


def collect(
    performances: Iterable[Performance],
    gripper: FloatArray,
    report: Report,
    **metadata: Any,
) -> Demonstrations:
    """Return performances as the demonstrations of their task.

    Args:
        performances: of one task.
        gripper: (T,) commanded reference of the gripper in each, 0 open to 1 closed.
        report: is told how each went.
        metadata: of the demonstrations.

    Raises:
        RuntimeError: one of them did not succeed, or was too fast.
    """
    kept = []
    for number, shown in enumerate(performances, start=1):
        rate = np.abs(np.diff(shown.movement, axis=0)).max(axis=0) * (len(shown.movement) - 1)
        share = float((rate / shown.duration / JOINT_VELOCITY).max())
        outcome = "success" if shown.info["is_success"] else shown.info["failure"] or "unfinished"
        told = f"demonstration {number}: {outcome}, {shown.duration:.2f} s"
        told += f", {100 * share:.0f} % of the speed limit"
        if outcome != "success" or share > SPEED_LIMIT:
            raise RuntimeError(told)
        report(told)
        kept.append(shown)
    return Demonstrations(
        task=kept[0].scene.task,
        configurations=np.array([resample(shown.configurations) for shown in kept]),
        gripper=np.tile(gripper, (len(kept), 1)),
        durations=np.array([shown.duration for shown in kept]),
        scenes=tuple(shown.scene for shown in kept),
        metadata={
            "recorded_by": "scripts/record_demonstrations.py",
            "finger_angles": np.mean([shown.finger_angles for shown in kept], axis=0).tolist(),
            **metadata,
        },
    )
