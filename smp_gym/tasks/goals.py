"""Goal vectors: their fields, and the goals of a scene as values of these fields and back."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from smp_gym.arrays import FloatArray
from smp_gym.scene import Goal, Scene

__all__ = ["Field", "GoalCodec", "flag", "position", "resting_place"]


@dataclass(frozen=True)
class Field:
    """A named range of a vector's entries, with the bounds of its entries."""

    name: str
    size: int
    low: float
    high: float


def position(name: str, points: int = 1) -> Field:
    """Return the field of so many points (x, y, z), m."""
    return Field(name, 3 * points, -5.0, 5.0)


def flag(name: str, count: int = 1) -> Field:
    """Return the field of so many flags; a flag of 1 in the desired goal is demanded."""
    return Field(name, count, 0.0, 1.0)


@dataclass(frozen=True)
class GoalCodec:
    """The codec between the goals of a task's scenes and the desired goal.

    Attributes:
        layout: fields of achieved and desired goal; ``collided`` must be one of them.
        encode: returns the values of the desired goal of a scene by field name; ValueError if the
            scene lacks what they take.
        decode: returns the goals that `encode` encoded, from the values of the desired goal by
            field name and the half-extents (3,) m of the object; ValueError if there are none.
        with_object: whether scenes of the task have an object; otherwise the hand holds a pen.
    """

    layout: tuple[Field, ...]
    encode: Callable[[Scene], dict[str, Any]]
    decode: Callable[[Mapping[str, FloatArray], FloatArray], tuple[Goal, ...]]
    with_object: bool = True

    def columns(self, name: str) -> slice:
        """Return the columns of a field in the goal vectors.

        Raises:
            KeyError: no such field.
        """
        start = 0
        for field in self.layout:
            if field.name == name:
                return slice(start, start + field.size)
            start += field.size
        raise KeyError(name)


def resting_place(scene: Scene, index: int) -> tuple[float, float, float]:
    """Return the resting place of the object's centre at goal `index`, m.

    Raises:
        ValueError: the scene has no object.
    """
    if scene.manipulated is None:
        raise ValueError(f"a scene of {scene.task} needs a manipulated object, got None")
    x, y, z = scene.goals[index].position
    return (x, y, z + scene.manipulated.size[2])
