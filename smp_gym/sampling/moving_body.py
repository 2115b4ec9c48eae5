"""The body that moves: demonstrated trajectories, and the spheres that cover arm, hand, object."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from smp_gym.arrays import BoolArray, FloatArray
from smp_gym.robot import kinematics
from smp_gym.robot.forward_kernels import sphere_paths
from smp_gym.sampling.swept_path import SweptPath

__all__ = ["Looks", "MovingBody"]
_Body = TypeVar("_Body", bound="MovingBody")

_GLANCE = 8
"""Every so-many-th sample of a trajectory is looked at first."""


class Looks(NamedTuple):
    """A path, and few samples of it: a glance at them spares the close look at most obstacles.

    Attributes:
        glance: the few samples.
        whole: all.
    """

    glance: SweptPath
    whole: SweptPath

    def clear(self, rows: FloatArray, clearance: float) -> BoolArray:
        """Return a mask (M,) of obstacles that keep a clearance (m) from the path."""
        clear = self.glance.clear(rows, clearance)
        clear[clear] = self.whole.clear(rows[clear], clearance)
        return clear


@dataclass(frozen=True, eq=False)
class MovingBody:
    """The demonstrated movements, and the body that moves; built once per process.

    Attributes:
        demonstrations: (N, T, 6) rad.
        spheres: arm, fingers and what the hand holds.
        moving: index of the spheres that could touch the table.
        swept: index of the spheres that the family is compared by: those but for the fingers, which
            lie between palm and object.
        pairs: (P, 2) spheres that may not touch each other.
    """

    demonstrations: FloatArray
    spheres: kinematics.SphereSet
    moving: NDArray[np.int64]
    swept: NDArray[np.int64]
    pairs: NDArray[np.int64]

    @classmethod
    def holding(
        cls: type[_Body],
        demonstrations: FloatArray,
        finger_angles: list[float],
        held: kinematics.SphereSet,
        /,
        **more: Any,
    ) -> _Body:
        """Return the body of arm, fingers and held object.

        Args:
            demonstrations: (N, T, 6) rad.
            finger_angles: of the hand that holds it, rad.
            held: spheres that cover what the hand holds.
            more: what a subclass has besides.
        """
        arm, fingers = kinematics.arm_spheres(), kinematics.finger_spheres(finger_angles)
        spheres = kinematics.concatenate(arm, fingers, held)
        moving = np.flatnonzero(spheres.link >= 2)
        return cls(
            demonstrations=demonstrations,
            spheres=spheres,
            moving=moving,
            swept=np.setdiff1d(moving, np.arange(len(arm), len(arm) + len(fingers))),
            pairs=kinematics.self_collision_pairs(spheres),
            **more,
        )

    def paths(self, trajectories: FloatArray, which: NDArray[np.int64] | None = None) -> FloatArray:
        """Return (N, T, S, 3) m, centres of spheres (all, or the given) along trajectories."""
        link, center = self.spheres.link, self.spheres.center
        if which is not None:
            link, center = link[which], center[which]
        flat = np.ascontiguousarray(trajectories.reshape(-1, trajectories.shape[-1]))
        centers = sphere_paths(
            flat, kinematics.BASE_TRANSFORM, kinematics.JOINT_ORIGINS, link, center
        )
        return centers.reshape(*trajectories.shape[:-1], len(link), 3)

    def swept_path(
        self, trajectory: FloatArray, which: NDArray[np.int64] | None = None
    ) -> SweptPath:
        """Return the path of the body's spheres (all, or the given) on a trajectory (T, 6)."""
        radius = self.spheres.radius if which is None else self.spheres.radius[which]
        return SweptPath.of(self.paths(trajectory, which), radius)

    def looks(self, trajectory: FloatArray, stride: int = _GLANCE) -> Looks:
        """Return what is looked at of a trajectory (T, 6): every so-many-th sample, then all."""
        return Looks(self.swept_path(trajectory[::stride]), self.swept_path(trajectory))
