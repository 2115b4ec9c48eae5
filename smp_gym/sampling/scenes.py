"""(task, version, family, difficulty, seed) -> `Scene`, for every task."""

from __future__ import annotations

from smp_gym.arrays import FloatArray, checked_count, checked_seed
from smp_gym.sampling.draws import first_scene
from smp_gym.sampling.specification import CROWDED, generator
from smp_gym.scene import DIFFICULTIES, FAMILIES, Scene
from smp_gym.tasks.registry import task_definition, task_families

__all__ = [
    "place_without_witness",
    "sample_scene",
    "sample_with_witness",
]

_MAX_DRAWS = 400
"""Largest number of goals drawn in all."""


def sample_with_witness(
    task: str, difficulty: str, seed: int, family: str = FAMILIES[0], version: int | None = None
) -> tuple[Scene, FloatArray]:
    """Return a scene and a trajectory that solves it.

    Args:
        task: name of the task, one of `smp_gym.scene.TASKS`.
        difficulty: one of `smp_gym.scene.DIFFICULTIES`.
        seed: not negative; below `smp_gym.scene.EVALUATION_SEEDS_START` for tuning, from there on
            for evaluation.
        family: one of `smp_gym.tasks.registry.task_families`; "none", the difficulty without
            obstacles, there is in the first only.
        version: version of the task's scene distribution, by default the present one.

    Returns:
        The scene, and its feasible reference trajectory (200, 6) in rad at equal steps of phase,
        here called witness: from the scene's start to the release, within joint limits, executable
        in 14 s within the velocity limits.

    Raises:
        ValueError: no such task, difficulty or family, a negative seed or version, or a task whose
            scenes are drawn without a witness.
    """
    scene, witness = _sample(task, difficulty, seed, family, version)
    if witness is None:
        raise ValueError(f"scenes of {task} are drawn without a witness")
    return scene, witness


def sample_scene(
    task: str, difficulty: str, seed: int, family: str = FAMILIES[0], version: int | None = None
) -> Scene:
    """Return the scene of (task, version, family, difficulty, seed), a pure function of these.

    Args:
        task: name of the task, one of `smp_gym.scene.TASKS`.
        difficulty: one of `smp_gym.scene.DIFFICULTIES`.
        seed: not negative.
        family: one of `smp_gym.tasks.registry.task_families`.
        version: version of the task's scene distribution, by default the present one.

    Raises:
        ValueError: no such task, difficulty or family, or a negative seed or version.
    """
    return _sample(task, difficulty, seed, family, version)[0]


def place_without_witness(
    task: str, difficulty: str, seed: int, version: int | None = None
) -> Scene:
    """Return the scene of (task, version, difficulty, seed) that is placed without a witness.

    A scene with a witness favours planners that look where witnesses are looked for. Here obstacles
    are chosen to block the mean and as many proposals as they can; they keep clear of the
    configurations that all proposals share, but of nothing else. So some of these scenes cannot be
    solved; `scripts/make_benchmark.py` certifies those that can.

    Args:
        task: name of the task, one of `smp_gym.scene.TASKS`.
        difficulty: one of `smp_gym.scene.DIFFICULTIES` but "none", which has nothing to place.
        seed: not negative.
        version: version of the task's scene distribution, by default the present one.

    Returns:
        The scene. Its own `seed` is None, since `sample_scene` would draw another one from it.

    Raises:
        ValueError: no such task or difficulty, a negative seed or version, or a task that has no
            such scenes.
    """
    definition = task_definition(task)
    if difficulty not in CROWDED:
        raise ValueError(f"difficulty must be one of {', '.join(CROWDED)}; got {difficulty!r}")
    if definition.sampler.place is None:
        raise ValueError(f"scenes of {task} are not placed without a witness")
    seed, version = _checked(seed, definition.version if version is None else version)
    rng = generator(task, f"{difficulty}/without a witness", seed, version)
    identity = {"task": task, "version": version, "difficulty": difficulty}
    return first_scene(definition.sampler.place, rng, _MAX_DRAWS, **identity)[0]


def _sample(
    task: str, difficulty: str, seed: int, family: str, version: int | None
) -> tuple[Scene, FloatArray | None]:
    definition = task_definition(task)
    known = task_families(task)
    if family not in known:
        raise ValueError(f"family of {task} must be one of {', '.join(known)}; got {family!r}")
    allowed = DIFFICULTIES if family == FAMILIES[0] else CROWDED
    if difficulty not in allowed:
        raise ValueError(
            f"difficulty of {family} must be one of {', '.join(allowed)}; got {difficulty!r}"
        )
    seed, version = _checked(seed, definition.version if version is None else version)
    name = difficulty if family == FAMILIES[0] else f"{family}/{difficulty}"
    rng = generator(task, name, seed, version)
    identity = {
        "task": task,
        "version": version,
        "family": family,
        "difficulty": difficulty,
        "seed": seed,
    }
    return first_scene(definition.sampler.drawing(family), rng, _MAX_DRAWS, **identity)


def _checked(seed: int, version: int) -> tuple[int, int]:
    return checked_seed(seed), checked_count("version", version, least=0)
