"""Poses: rigid transforms of bodies and frames."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from smp_gym.arrays import FloatArray, checked_array

__all__ = ["Pose", "checked_pose"]


_NORM_TOLERANCE = 1e-6
"""Largest deviation of a quaternion's norm from 1."""


@dataclass(frozen=True)
class Pose:
    """A rigid transform: a turn, then a shift.

    Attributes:
        rotation: the turn.
        position: (3,) m, the shift.
    """

    rotation: Rotation
    position: FloatArray

    @classmethod
    def identity(cls) -> Pose:
        """Return the transform that leaves all as it is."""
        return cls(Rotation.identity(), np.zeros(3))

    def of(self, points: FloatArray) -> FloatArray:
        """Return where points (..., 3) m come to lie."""
        turned = self.rotation.apply(points.reshape(-1, 3)).reshape(points.shape)
        return np.asarray(turned + self.position)

    def then(self, inner: Pose) -> Pose:
        """Return the composition of this pose with `inner`, which is given in its frame."""
        return Pose(self.rotation * inner.rotation, self.of(inner.position))

    def inverse(self) -> Pose:
        """Return the transform that undoes this one."""
        turn = self.rotation.inv()
        return Pose(turn, -turn.apply(self.position))

    @property
    def quaternion(self) -> tuple[float, float, float, float]:
        """The turn as x, y, z, w of norm 1."""
        x, y, z, w = self.rotation.as_quat().tolist()
        return x, y, z, w


def checked_pose(position: ArrayLike, quaternion: ArrayLike, *, where: str = "") -> Pose:
    """Return the pose of a position and a quaternion that a user gave.

    Args:
        position: (3,) m.
        quaternion: (4,) x, y, z, w.
        where: what stands before their names in messages.

    Raises:
        ValueError: not finite numbers of these shapes, or another norm.
    """
    shift = checked_array(f"{where}position", position, (3,))
    turn = checked_array(f"{where}quaternion", quaternion, (4,))
    if abs(float(np.linalg.norm(turn)) - 1.0) > _NORM_TOLERANCE:
        raise ValueError(f"{where}quaternion must have norm 1, got {turn.tolist()}")
    return Pose(Rotation.from_quat(turn), shift)
