"""Feasible reference trajectories (witnesses) of sampled scenes, played in the physics."""

from __future__ import annotations

import functools
from typing import Any

import gymnasium

import smp_gym  # noqa: F401  (registers the environments)
from smp_gym.arrays import FloatArray
from smp_gym.datasets.demonstrations import Demonstrations
from smp_gym.registration import environment_id
from smp_gym.rollout import play
from smp_gym.sampling import sample_with_witness
from smp_gym.scene import Scene

__all__ = ["trajectory_solves", "witness_solves"]


@functools.lru_cache(maxsize=1)
def _env(task: str) -> gymnasium.Env[Any, Any]:
    return gymnasium.make(environment_id(task), difficulty="none")


@functools.lru_cache(maxsize=1)
def _grasp(task: str) -> int | None:
    """Return the sample of a trajectory at which the hand closes, None if it holds the object."""
    samples = Demonstrations.load(task).metadata.get("push_samples")
    return None if samples is None else int(samples[1])


def trajectory_solves(scene: Scene, trajectory: FloatArray) -> bool:
    """Return whether a trajectory succeeds in the physics.

    Args:
        scene: in which it is played.
        trajectory: (T, 6) rad at equal steps of phase; see `smp_gym.rollout.play`.
    """
    played = play(_env(scene.task), scene, trajectory, grasp=_grasp(scene.task))
    return bool(played["is_success"])


def witness_solves(cell: tuple[str, str, int]) -> bool:
    """Return whether the witness of (task, difficulty, seed) succeeds in the physics."""
    task, difficulty, seed = cell
    return trajectory_solves(*sample_with_witness(task, difficulty, seed))
