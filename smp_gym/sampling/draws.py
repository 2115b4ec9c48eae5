"""Draws of a task's sampler, and the scenes made of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from smp_gym.arrays import FloatArray
from smp_gym.robot.kinematics import UnreachableError
from smp_gym.sampling.conversion import to_configuration, to_obstacle
from smp_gym.scene import FAMILIES, Goal, ManipulatedObject, Motion, Obstacle, Scene

__all__ = ["Draw", "SceneSampler", "first_scene"]

_DEFAULT_OBJECT = ManipulatedObject()


@dataclass(frozen=True, eq=False)
class Draw:
    """The random quantities of one scene.

    Attributes:
        start: (6,) rad.
        goals: of the scene.
        rows: (M, 9) rows of obstacles, see `smp_gym.sampling.kernels`.
        witness: (W, 6) rad, a feasible reference trajectory; None where none was looked for.
        manipulated: the object, or None.
        motions: of the obstacles, None for those that stand; empty if all do.
    """

    start: FloatArray
    goals: tuple[Goal, ...]
    rows: FloatArray
    witness: FloatArray | None = None
    manipulated: ManipulatedObject | None = _DEFAULT_OBJECT
    motions: tuple[Motion | None, ...] = ()

    @property
    def obstacles(self) -> tuple[Obstacle, ...]:
        """The obstacles of the scene."""
        motions = self.motions or (None,) * len(self.rows)
        return tuple(
            to_obstacle(row, motion) for row, motion in zip(self.rows, motions, strict=True)
        )


Drawing = Callable[[str, np.random.Generator], Draw | None]


@dataclass(frozen=True)
class SceneSampler:
    """The functions that draw the scenes of a task.

    Each function takes difficulty and source of randomness, and returns None or raises
    `UnreachableError` where what it drew does not fit together: it is then called again.

    Attributes:
        draw: draws goals, obstacles and a feasible reference trajectory.
        place: draws goals and obstacles without looking for one; None if the task has no such
            scenes.
        families: of scenes besides, by name: each draws goals, obstacles and a feasible reference
            trajectory.
    """

    draw: Drawing
    place: Drawing | None = None
    families: Mapping[str, Drawing] = field(default_factory=dict)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the families that there are, out of `smp_gym.scene.FAMILIES`."""
        return (FAMILIES[0], *self.families)

    def drawing(self, family: str) -> Drawing:
        """Return the function that draws a family's scenes.

        Raises:
            KeyError: the task has no such scenes.
        """
        return self.draw if family == FAMILIES[0] else self.families[family]


def first_scene(
    drawing: Drawing, rng: np.random.Generator, attempts: int, **identity: Any
) -> tuple[Scene, FloatArray | None]:
    """Draw until everything fits together; return the scene and its witness.

    Args:
        drawing: draws once.
        rng: source of all randomness.
        attempts: how often at most.
        identity: fields of the `Scene` that say which it is: task, version, family, difficulty,
            seed.

    Raises:
        RuntimeError: nothing fitted together.
    """
    for _ in range(attempts):
        try:
            drawn = drawing(identity["difficulty"], rng)
        except UnreachableError:
            continue
        if drawn is not None:
            scene = Scene(
                **identity,
                start=to_configuration(drawn.start),
                manipulated=drawn.manipulated,
                goals=drawn.goals,
                obstacles=drawn.obstacles,
            )
            return scene, drawn.witness
    raise RuntimeError(f"no scene found for {identity}")
