"""(task, version, difficulty, seed) -> `Scene`, for every task."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from smp_gym.sampling import strokes
from smp_gym.sampling.placing import draw_double_sided, draw_placement
from smp_gym.sampling.push_lift_scenes import draw_push_lift
from smp_gym.sampling.specification import SPECIFICATIONS, generator
from smp_gym.sampling.way import Draw, first_scene
from smp_gym.scene import DIFFICULTIES, TASKS, Scene

__all__ = ["sample_scene", "sample_with_witness"]

FloatArray = NDArray[np.float64]


_MAX_DRAWS = 200
"""How many goals and families are drawn in all."""


_DRAWS: dict[str, Callable[[str, np.random.Generator], Draw | None]] = {
    "Placement": draw_placement,
    "DoubleSidedPlacement": draw_double_sided,
    "PushLiftBox": draw_push_lift,
}


def sample_with_witness(
    task: str, difficulty: str, seed: int, version: int = 0
) -> tuple[Scene, FloatArray]:
    """Return a scene and a trajectory that solves it.

    Args:
        task: name of the task, one of `smp_gym.scene.TASKS`.
        difficulty: one of `smp_gym.scene.DIFFICULTIES`.
        seed: not negative; below `smp_gym.scene.EVALUATION_SEEDS_START` for tuning, from there on
            for evaluation.
        version: version of the task's scene distribution.

    Returns:
        The scene, and the witness (200, 6) in rad at equal steps of phase: from the scene's start
        to the release, within joint limits, executable in 14 s within the velocity limits.

    Raises:
        ValueError: no such task or difficulty, or a negative seed or version.
    """
    if task not in TASKS:
        raise ValueError(f"task must be one of {', '.join(TASKS)}; got {task!r}")
    if difficulty not in SPECIFICATIONS:
        raise ValueError(f"difficulty must be one of {', '.join(DIFFICULTIES)}; got {difficulty!r}")
    if seed < 0 or version < 0:
        raise ValueError(f"seed and version must not be negative, got {seed} and {version}")
    rng = generator(task, difficulty, seed, version)
    if task == "DrawS":
        return strokes.sample(SPECIFICATIONS[difficulty], rng, difficulty, seed, version)
    draw = partial(_DRAWS[task], difficulty, rng)
    return first_scene(
        draw, _MAX_DRAWS, task=task, version=version, difficulty=difficulty, seed=seed
    )


def sample_scene(task: str, difficulty: str, seed: int, version: int = 0) -> Scene:
    """Return the scene of (task, version, difficulty, seed), a pure function of these.

    Args:
        task: name of the task, one of `smp_gym.scene.TASKS`.
        difficulty: one of `smp_gym.scene.DIFFICULTIES`.
        seed: not negative.
        version: version of the task's scene distribution.

    Raises:
        ValueError: no such task or difficulty, or a negative seed or version.
    """
    scene, _ = sample_with_witness(task, difficulty, seed, version)
    return scene
