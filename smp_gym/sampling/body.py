"""What moves: demonstrated trajectories, and the spheres that cover arm, hand and object."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from smp_gym.robot import kinematics
from smp_gym.robot.forward_kernels import sphere_paths
from smp_gym.sampling.push import Push
from smp_gym.scene import Configuration, ManipulatedObject

__all__ = ["Body", "ObjectTask", "make_task"]

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Body:
    """The demonstrated movements, and the body that moves; built once per process.

    Attributes:
        demonstrations: (N, T, 6) rad.
        spheres: arm, fingers and what the hand holds.
        moving: index of the spheres that could touch the table.
        swept: index of the spheres that the family is compared by: those but for the fingers, which
            lie between palm and object.
        pairs: (P, 2) spheres that may not touch each other.
        push: what comes before the hand holds the object, if it does not from the start.
    """

    demonstrations: FloatArray
    spheres: kinematics.SphereSet
    moving: NDArray[np.int64]
    swept: NDArray[np.int64]
    pairs: NDArray[np.int64]
    push: Push | None = field(default=None, kw_only=True)

    def paths(self, trajectories: FloatArray, which: NDArray[np.int64] | None = None) -> FloatArray:
        """Return (N, T, S, 3) m, centres of spheres (all, or the given) along trajectories."""
        paths = self._paths(trajectories, self.spheres, which)
        if self.push is None:
            return paths
        phase = np.linspace(0.0, 1.0, trajectories.shape[-2])
        holding = (phase > self.push.phases[1])[:, None, None]
        return np.where(holding, self._paths(trajectories, self.push.spheres, which), paths)

    def _paths(
        self,
        trajectories: FloatArray,
        spheres: kinematics.SphereSet,
        which: NDArray[np.int64] | None,
    ) -> FloatArray:
        link, center = spheres.link, spheres.center
        if which is not None:
            link, center = link[which], center[which]
        flat = np.ascontiguousarray(trajectories.reshape(-1, trajectories.shape[-1]))
        centers = sphere_paths(
            flat, kinematics.BASE_TRANSFORM, kinematics.JOINT_ORIGINS, link, center
        )
        return centers.reshape(*trajectories.shape[:-1], len(link), 3)


@dataclass(frozen=True, eq=False)
class ObjectTask(Body):
    """What sampling needs to know of a task that sets an object down or lifts it.

    Attributes:
        start: (6,) rad.
        release_rotation: (3, 3) orientation of the end effector at the demonstrations' mean end.
        release_height: m, of the object's centre over the goal there.
        nominal_goal: (3,) m, mean goal of the demonstrations.
        held: (4, 4) pose of the held object in the end-effector frame.
        samples: of each member of a family.
        proposals: how many detours of ordinary width are drawn.
        wide: how many wide ones.
        widest: up to so many times as wide as ordinary ones.
    """

    start: FloatArray
    release_rotation: FloatArray
    release_height: float
    nominal_goal: FloatArray
    held: FloatArray
    samples: int = 20
    proposals: int = 104
    wide: int = 144
    widest: float = 2.5

    @property
    def pins(self) -> tuple[float, ...]:
        """Phases at which detours are zero."""
        return (0.0, 1.0) if self.push is None else (0.0, *self.push.phases, 1.0)


def make_task(
    demonstrations: FloatArray,
    goal: FloatArray,
    start: Configuration,
    held: FloatArray,
    finger_angles: list[float],
) -> ObjectTask:
    """Return what sampling needs to know of a task without a push.

    Args:
        demonstrations: (N, T, 6) rad.
        goal: (3,) m, mean goal of the demonstrations.
        start: rad.
        held: (4, 4) pose of the held object in the end-effector frame.
        finger_angles: of the hand that holds it, rad.
    """
    parts = (
        kinematics.arm_spheres(),
        kinematics.finger_spheres(finger_angles),
        kinematics.box_spheres(ManipulatedObject().size, held),
    )
    spheres = kinematics.concatenate(*parts)
    moving = np.flatnonzero(spheres.link >= 2)
    first_finger = len(parts[0])
    fingers = np.arange(first_finger, first_finger + len(parts[1]))
    pose = kinematics.end_effector_pose(demonstrations.mean(axis=0)[-1])
    return ObjectTask(
        demonstrations=demonstrations,
        start=np.asarray(start, np.float64),
        spheres=spheres,
        moving=moving,
        swept=np.setdiff1d(moving, fingers),
        pairs=kinematics.self_collision_pairs(spheres),
        release_rotation=pose[:3, :3],
        release_height=float((pose @ held)[2, 3] - goal[2]),
        nominal_goal=goal,
        held=np.asarray(held),
    )
