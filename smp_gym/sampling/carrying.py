"""Demonstrations carried to another start, push and goal."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from smp_gym.robot import kinematics
from smp_gym.sampling.body import ObjectTask
from smp_gym.sampling.detours import resample, smoothstep
from smp_gym.sampling.push import Push
from smp_gym.scene import Goal

__all__ = ["carry", "release_configuration"]

FloatArray = NDArray[np.float64]


def release_configuration(task: ObjectTask, goal: Goal) -> FloatArray:
    """Return the (6,) rad of the release over a goal: the demonstrated one, turned about the base.

    Raises:
        UnreachableError: the goal is out of reach.
    """
    position = np.asarray(goal.position)
    turn = np.arctan2(position[1], position[0]) - np.arctan2(
        task.nominal_goal[1], task.nominal_goal[0]
    )
    c, s = np.cos(turn), np.sin(turn)
    rotation = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ task.release_rotation
    center = position + np.array([0.0, 0.0, task.release_height])
    held = task.held[:3, 3]
    seed = task.demonstrations[:, -1].mean(axis=0)
    seed[0] -= turn
    return kinematics.inverse_kinematics(center - rotation @ held, rotation, seed=seed)


def carry(task: ObjectTask, goal: FloatArray, samples: int) -> FloatArray:
    """Return the demonstrations, (N, samples, 6), blended to start and goal configuration."""
    if task.push is not None:
        return _carry_with_push(task, task.push, goal, samples)
    carried = resample(task.demonstrations, samples)
    blend = smoothstep(np.linspace(0.0, 1.0, samples))[:, None]
    to_start = (task.start - carried[:, 0])[:, None]
    to_goal = (goal - carried[:, -1])[:, None]
    result: FloatArray = carried + (1.0 - blend) * to_start + blend * to_goal
    return result


def _carry_with_push(task: ObjectTask, push: Push, goal: FloatArray, samples: int) -> FloatArray:
    """Return the demonstrations, (N, samples, 6), blended to start, push and goal configuration."""
    carried = resample(task.demonstrations, samples)
    phase = np.linspace(0.0, 1.0, samples)
    begin, end = push.phases
    last = task.demonstrations.shape[1] - 1
    pushing = push.at(phase)
    behind, grasp = push.configurations[0], push.configurations[-1]
    to_start = task.start - task.demonstrations[:, 0]
    to_behind = behind - task.demonstrations[:, round(begin * last)]
    to_grasp = grasp - task.demonstrations[:, round(end * last)]
    to_goal = goal - task.demonstrations[:, -1]
    before = smoothstep(np.clip(phase / begin, 0.0, 1.0))[:, None]
    after = smoothstep(np.clip((phase - end) / (1.0 - end), 0.0, 1.0))[:, None]
    approach = carried + (1.0 - before) * to_start[:, None] + before * to_behind[:, None]
    lift = carried + (1.0 - after) * to_grasp[:, None] + after * to_goal[:, None]
    result: FloatArray = np.where((phase < begin)[:, None], approach, pushing)
    result = np.where((phase > end)[:, None], lift, result)
    return result
