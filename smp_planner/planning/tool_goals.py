"""Regions, via-points and via-poses of a robot's tool, as data."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from smp_gym.arrays import FloatArray, checked_array, checked_number
from smp_planner.movement_primitives.box_prior import box_offset
from smp_planner.planning.tool_orientations import ToolOrientation, checked_orientation

__all__ = ["GoalRegion", "ToolViaPoint", "ViaPose"]


def _checked_phase(name: str, phase: float) -> None:
    checked_number(f"{name}.phase", phase, least=0.0, most=1.0)


@dataclass(frozen=True)
class GoalRegion:
    """A box in which a point carried by the hand must be when the trajectory ends.

    Attributes:
        point: (3,) m, fixed in the end-effector frame (for Placement, the object's centre).
        lower: (3,) m, lower corner of the box in the base frame.
        upper: (3,) m, upper corner.
        orientation: that the hand must have there, a `Cone` or an `Orientation`; None leaves it
            free. Problems of the environments' tasks have it free.
    """

    point: FloatArray
    lower: FloatArray
    upper: FloatArray
    orientation: ToolOrientation | None = None

    def __post_init__(self) -> None:
        for name in ("point", "lower", "upper"):
            value = checked_array(f"GoalRegion.{name}", getattr(self, name), (3,))
            object.__setattr__(self, name, value)
        if not (self.lower <= self.upper).all():
            raise ValueError(f"GoalRegion.lower {self.lower} must not exceed upper {self.upper}")
        checked_orientation("GoalRegion.orientation", self.orientation)

    @property
    def center(self) -> FloatArray:
        """(3,) m, middle of the box."""
        return (self.lower + self.upper) / 2

    def distance(self, points: FloatArray) -> FloatArray:
        """Return the distance (...) m of points (..., 3) to the box; 0 inside."""
        outside = box_offset(points, self.lower, self.upper)
        return np.asarray(np.linalg.norm(outside, axis=-1))


@dataclass(frozen=True)
class ViaPose:
    """A pose that the hand must take at a phase.

    Attributes:
        phase: in [0, 1].
        pose: (4, 4) of the end effector in the base frame.
        rest: whether the arm stands still there.
    """

    phase: float
    pose: FloatArray
    rest: bool = False

    def __post_init__(self) -> None:
        _checked_phase("ViaPose", self.phase)
        object.__setattr__(self, "pose", checked_array("ViaPose.pose", self.pose, (4, 4)))


@dataclass(frozen=True)
class ToolViaPoint:
    """A place that a point carried by the hand must pass at about a phase.

    Attributes:
        phase: in [0, 1].
        point: (3,) m, fixed in the end-effector frame (for DrawS, the pen's tip).
        position: (3,) m, of the place in the base frame.
        tolerance: m, how near the point must come.
        orientation: as of `GoalRegion`.
    """

    phase: float
    point: FloatArray
    position: FloatArray
    tolerance: float
    orientation: ToolOrientation | None = None

    def __post_init__(self) -> None:
        for name in ("point", "position"):
            value = checked_array(f"ToolViaPoint.{name}", getattr(self, name), (3,))
            object.__setattr__(self, name, value)
        _checked_phase("ToolViaPoint", self.phase)
        checked_number("ToolViaPoint.tolerance", self.tolerance, above=0.0)
        checked_orientation("ToolViaPoint.orientation", self.orientation)

    @property
    def center(self) -> FloatArray:
        """(3,) m, the place."""
        return self.position

    def distance(self, points: FloatArray) -> FloatArray:
        """Return by how much points (..., 3) m miss the place, (...) m; 0 within the tolerance."""
        away = np.linalg.norm(points - self.position, axis=-1)
        return np.maximum(away - self.tolerance, 0.0)
