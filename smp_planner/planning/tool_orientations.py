"""Orientations that a robot's tool may have: within a cone, or fixed within a tolerance."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from smp_gym.arrays import FloatArray, checked_array, checked_number, shown
from smp_gym.geometry.pose import checked_pose

__all__ = ["Cone", "Orientation", "ToolOrientation", "checked_orientation", "inner_angle"]

_MOST_MARGIN = 0.25
"""rad, that orientations within an angle keep from its border at most."""

_ALIGNED = 1e-12
"""Sine of the angle between two axes up to which these are parallel."""


def _unit(name: str, value: Any) -> FloatArray:
    """Return a vector (3,) of length 1 along the given one."""
    vector = checked_array(name, value, (3,))
    # Scaled first: squares of very small or large numbers would be 0 or infinite.
    largest = float(np.abs(vector).max())
    if largest == 0.0:
        raise ValueError(f"{name} must not be zero, got {vector.tolist()}")
    vector = vector / largest
    return np.asarray(vector / np.linalg.norm(vector))


@dataclass(frozen=True, eq=False)
class Cone:
    """Orientations of the tool that hold one of its axes within an angle of a direction.

    How the tool is turned about that axis is left open.

    Attributes:
        axis: (3,) fixed in the tip's frame, not zero; its length does not matter.
        direction: (3,) in the base frame, likewise.
        angle: rad, between 0 and π, by which the axis may be away from the direction.
    """

    axis: FloatArray
    direction: FloatArray
    angle: float

    def __post_init__(self) -> None:
        for name in ("axis", "direction"):
            object.__setattr__(self, name, _unit(f"Cone.{name}", getattr(self, name)))
        angle = checked_number("Cone.angle", self.angle, least=0.0, most=math.pi)
        object.__setattr__(self, "angle", angle)

    @property
    def allowed(self) -> float:
        """Angle, rad, up to which a tool has such an orientation."""
        return self.angle

    def turned(self, rotations: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return by what angles the axis is away from the direction, and about which axes.

        Args:
            rotations: (..., 3, 3) from the tip's frame to the base frame.

        Returns:
            (...) rad, and unit axes (..., 3) in the base frame, about which a turn of the
            tool makes the angle larger at its own rate.
        """
        own = rotations @ self.axis
        across = np.cross(np.broadcast_to(self.direction, own.shape), own)
        sine = np.linalg.norm(across, axis=-1)
        angle = np.arctan2(sine, own @ self.direction)
        # Of parallel axes, any across will do.
        other = np.cross(self.direction, np.eye(3)[np.abs(self.direction).argmin()])
        aligned = (sine <= _ALIGNED)[..., None]
        axis = np.where(aligned, other, across)
        return angle, axis / np.linalg.norm(axis, axis=-1, keepdims=True)

    def bound(self, rotation: FloatArray) -> FloatArray:
        """Return the projector (3, 3) of turns of a tool with a rotation (3, 3) that matter."""
        own = rotation @ self.axis
        return np.asarray(np.eye(3) - np.outer(own, own))


@dataclass(frozen=True, eq=False)
class Orientation:
    """Orientations of the tool that differ from one by a turn of at most a tolerance.

    Attributes:
        quaternion: (4,) x, y, z, w of norm 1, from the tip's frame to the base frame.
        tolerance: rad, between 0 and π, angle of the turn about any axis that may remain.
    """

    quaternion: FloatArray
    tolerance: float

    def __post_init__(self) -> None:
        pose = checked_pose(np.zeros(3), self.quaternion, where="Orientation.")
        object.__setattr__(self, "quaternion", np.asarray(pose.rotation.as_quat()))
        tolerance = checked_number("Orientation.tolerance", self.tolerance, least=0.0, most=math.pi)
        object.__setattr__(self, "tolerance", tolerance)

    @property
    def allowed(self) -> float:
        """Angle, rad, up to which a tool has such an orientation."""
        return self.tolerance

    def turned(self, rotations: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return by what angles rotations differ from this one, and about which axes.

        Arguments and results are as of `Cone.turned`.
        """
        wanted = Rotation.from_quat(self.quaternion).as_matrix()
        difference = rotations @ wanted.T
        vectors = Rotation.from_matrix(difference.reshape(-1, 3, 3)).as_rotvec()
        vectors = vectors.reshape(*rotations.shape[:-2], 3)
        angle = np.linalg.norm(vectors, axis=-1)
        same = (angle <= _ALIGNED)[..., None]
        # Without a difference, a turn about any axis makes one.
        axis = np.where(same, [0.0, 0.0, 1.0], vectors)
        return angle, axis / np.linalg.norm(axis, axis=-1, keepdims=True)

    def bound(self, rotation: FloatArray) -> FloatArray:
        """Return the identity (3, 3): turns about all axes matter."""
        return np.eye(3)


ToolOrientation = Cone | Orientation
"""What a tool's orientation may be asked to be, where it is not free."""


def checked_orientation(name: str, value: Any) -> ToolOrientation | None:
    """Return what is asked of a tool's orientation; None leaves it free.

    Raises:
        ValueError: it is something else.
    """
    if value is not None and not isinstance(value, Cone | Orientation):
        raise ValueError(f"{name} must be a Cone, an Orientation or None, got {shown(value)}")
    return value


def inner_angle(orientation: ToolOrientation, share: float) -> float:
    """Return the angle, rad, within which an orientation keeps clear of what is not allowed.

    Args:
        orientation: that is asked for.
        share: of the allowed angle that is left; 0.25 rad from its border are enough, and where all
            orientations are allowed, there is none.
    """
    allowed = orientation.allowed
    if allowed >= math.pi:
        return math.pi
    return allowed - min((1.0 - share) * allowed, _MOST_MARGIN)
