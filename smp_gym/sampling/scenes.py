"""(task, version, difficulty or kind of furniture, seed) -> `Scene`, for every task."""

from __future__ import annotations

from smp_gym.arrays import FloatArray
from smp_gym.sampling.draws import first_scene
from smp_gym.sampling.furniture import FURNITURE
from smp_gym.sampling.specification import SPECIFICATIONS, generator
from smp_gym.scene import DIFFICULTIES, FAMILIES, Scene
from smp_gym.tasks.registry import task_definition, task_definitions

__all__ = [
    "place_without_witness",
    "sample_furniture",
    "sample_furniture_with_witness",
    "sample_of_family",
    "sample_scene",
    "sample_with_witness",
]

_MAX_DRAWS = 200
_MAX_FURNISHED_DRAWS = 400
"""Largest numbers of goals drawn in all, with obstacles and with furniture."""


def sample_with_witness(
    task: str, difficulty: str, seed: int, version: int | None = None
) -> tuple[Scene, FloatArray]:
    """Return a scene and a trajectory that solves it.

    Args:
        task: name of the task, one of `smp_gym.scene.TASKS`.
        difficulty: one of `smp_gym.scene.DIFFICULTIES`.
        seed: not negative; below `smp_gym.scene.EVALUATION_SEEDS_START` for tuning, from there on
            for evaluation.
        version: version of the task's scene distribution, by default the present one.

    Returns:
        The scene, and its feasible reference trajectory (200, 6) in rad at equal steps of phase,
        here called witness: from the scene's start to the release, within joint limits, executable
        in 14 s within the velocity limits.

    Raises:
        ValueError: no such task or difficulty, a negative seed or version, or a task whose scenes
            are drawn without a witness.
    """
    scene, witness = _sample(task, difficulty, seed, version)
    return scene, _present(witness, task)


def sample_scene(task: str, difficulty: str, seed: int, version: int | None = None) -> Scene:
    """Return the scene of (task, version, difficulty, seed), a pure function of these.

    Args:
        task: name of the task, one of `smp_gym.scene.TASKS`.
        difficulty: one of `smp_gym.scene.DIFFICULTIES`.
        seed: not negative.
        version: version of the task's scene distribution, by default the present one.

    Raises:
        ValueError: no such task or difficulty, or a negative seed or version.
    """
    return _sample(task, difficulty, seed, version)[0]


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
    crowded = [name for name in DIFFICULTIES if SPECIFICATIONS[name].obstacles]
    if difficulty not in crowded:
        raise ValueError(f"difficulty must be one of {', '.join(crowded)}; got {difficulty!r}")
    if definition.sampler.place is None:
        raise ValueError(f"scenes of {task} are not placed without a witness")
    version = _checked(seed, definition.version if version is None else version)
    rng = generator(task, f"{difficulty}/without a witness", seed, version)
    identity = {"task": task, "version": version, "difficulty": difficulty}
    return first_scene(definition.sampler.place, difficulty, rng, _MAX_DRAWS, **identity)[0]


def sample_furniture_with_witness(
    task: str, kind: str, seed: int, version: int | None = None
) -> tuple[Scene, FloatArray]:
    """Return a furnished scene and a trajectory that solves it.

    Args:
        task: one of `smp_gym.scene.FURNISHED_TASKS`.
        kind: of the furniture: "shelf", "box", "cage" or "table".
        seed: not negative; below `smp_gym.scene.EVALUATION_SEEDS_START` for tuning, from there on
            for evaluation.
        version: version of the task's scene distribution, by default the present one.

    Returns:
        The scene, of family `kind`, and the witness (200, 6) in rad as that of
        `smp_gym.sampling.sample_with_witness`.

    Raises:
        ValueError: no such task or kind, or a negative seed or version.
    """
    furnished = {known.name: known for known in task_definitions() if known.sampler.furnish}
    if task not in furnished:
        raise ValueError(
            f"task must be one of {', '.join(furnished)} to be furnished; got {task!r}"
        )
    if kind not in FURNITURE:
        raise ValueError(f"kind must be one of {', '.join(FURNITURE)}; got {kind!r}")
    furnish = furnished[task].sampler.furnish
    assert furnish is not None
    version = _checked(seed, furnished[task].version if version is None else version)
    rng = generator(task, f"furniture/{kind}", seed, version)
    identity = {"task": task, "version": version, "family": kind, "seed": seed}
    scene, witness = first_scene(furnish, kind, rng, _MAX_FURNISHED_DRAWS, **identity)
    return scene, _present(witness, task)


def sample_furniture(task: str, kind: str, seed: int, version: int | None = None) -> Scene:
    """Return the furnished scene of (task, version, kind, seed), a pure function of these.

    Args:
        task: one of `smp_gym.scene.FURNISHED_TASKS`.
        kind: of the furniture: "shelf", "box", "cage" or "table".
        seed: not negative.
        version: version of the task's scene distribution, by default the present one.

    Raises:
        ValueError: no such task or kind, or a negative seed or version.
    """
    return sample_furniture_with_witness(task, kind, seed, version)[0]


def sample_of_family(task: str, family: str, difficulty: str, seed: int) -> Scene:
    """Return the scene that an environment of this task, family and difficulty plays.

    Args:
        task: name of the task.
        family: one of `smp_gym.scene.FAMILIES`.
        difficulty: one of `smp_gym.scene.DIFFICULTIES`; furniture has none and disregards it.
        seed: not negative.

    Raises:
        ValueError: no such task, family or difficulty, a task without furniture, or a negative
            seed.
    """
    if family == FAMILIES[0]:
        return sample_scene(task, difficulty, seed)
    return sample_furniture(task, family, seed)


def _sample(
    task: str, difficulty: str, seed: int, version: int | None
) -> tuple[Scene, FloatArray | None]:
    definition = task_definition(task)
    if difficulty not in SPECIFICATIONS:
        raise ValueError(f"difficulty must be one of {', '.join(DIFFICULTIES)}; got {difficulty!r}")
    version = _checked(seed, definition.version if version is None else version)
    rng = generator(task, difficulty, seed, version)
    identity = {"task": task, "version": version, "difficulty": difficulty, "seed": seed}
    return first_scene(definition.sampler.draw, difficulty, rng, _MAX_DRAWS, **identity)


def _checked(seed: int, version: int) -> int:
    if seed < 0 or version < 0:
        raise ValueError(f"seed and version must not be negative, got {seed} and {version}")
    return version


def _present(witness: FloatArray | None, task: str) -> FloatArray:
    if witness is None:
        raise ValueError(f"scenes of {task} are drawn without a witness")
    return witness
