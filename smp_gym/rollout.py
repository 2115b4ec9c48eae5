"""Playing a joint trajectory in the environment, as demonstrations and witnesses are judged."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from smp_gym.observation import CONTROL_PERIOD
from smp_gym.robot.kinematics import JOINT_VELOCITY
from smp_gym.scene import Scene

__all__ = ["play"]

_SPEED = 0.9
"""Share of the velocity limits at which a trajectory is played."""

_WAITING_STEPS = 60
_CLOSING_STEPS = 20
_HOLDING_STEPS = 10
"""Steps after a release, while the hand closes, and at the end with the object held."""


def play(
    env: gymnasium.Env[Any, Any],
    scene: Scene,
    trajectory: NDArray[np.float64],
    duration: float | None = None,
    grasp: int | None = None,
) -> dict[str, Any]:
    """Execute a trajectory at constant speed of phase, and return the last step's `info`.

    Args:
        env: of the scene's task.
        scene: what to play it in.
        trajectory: (T, 6) rad at equal steps of phase.
        duration: s; default as fast as 0.9 times the velocity limits allow.
        grasp: sample at which the hand, open until then, closes on the object and holds it from
            then on; by default the object is in the hand, which lets go at the end.
    """
    phase = np.linspace(0.0, 1.0, len(trajectory))
    if duration is None:
        rate = np.abs(np.gradient(trajectory, phase, axis=0)) / JOINT_VELOCITY
        duration = float(rate.max()) / _SPEED
    steps = int(np.ceil(duration / CONTROL_PERIOD))
    at = np.linspace(0.0, 1.0, steps + 1)
    way = np.stack([np.interp(at, phase, column) for column in trajectory.T], axis=1)
    if grasp is None:
        targets = np.concatenate([way[1:], np.repeat(way[-1:], _WAITING_STEPS - 1, axis=0)])
        fingers = np.where(np.arange(1, len(targets) + 1) > steps, -1.0, 0.0)
    else:
        close = round(grasp / (len(trajectory) - 1) * steps)
        closing = np.repeat(way[close][None], _CLOSING_STEPS, axis=0)
        holding = np.repeat(way[-1:], _HOLDING_STEPS, axis=0)
        targets = np.concatenate([way[1 : close + 1], closing, way[close + 1 :], holding])
        fingers = np.where(np.arange(1, len(targets) + 1) <= close, -1.0, 1.0)
    observation, info = env.reset(options={"scene": scene})
    for target, finger in zip(targets, fingers, strict=True):
        move = (target - observation["observation"][6:12]) / (JOINT_VELOCITY * CONTROL_PERIOD)
        action = np.append(np.clip(move, -1.0, 1.0), finger).astype(np.float32)
        observation, _, terminated, truncated, info = env.step(action)
        if terminated or truncated:
            break
    return info
