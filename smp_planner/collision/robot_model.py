"""The arm as the planner sees it: a chain of joints and the spheres fixed to its links."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from smp_gym.arrays import BoolArray, FloatArray, IntArray, checked_array
from smp_gym.robot import forward_kernels, kinematics
from smp_gym.robot.kinematics import SphereSet

__all__ = [
    "LinkPairs",
    "RobotArrays",
    "RobotModel",
    "SingleArrays",
    "jaco_model",
    "jaco_of_spheres",
]


_STEPS_OF_A_TURN = 256


def _finite(name: str, value: Any, shape: tuple[int, ...]) -> FloatArray:
    # Read-only arrays are another type to the compiler: without the copies it would do its work
    # anew for each kind of robot.
    return checked_array(name, value, shape)


@dataclass(frozen=True, eq=False)
class LinkPairs:
    """Pairs of spheres that must not touch, by pair of links, with a ball around each link.

    Attributes:
        pairs: (M,2) indices of spheres, sorted by pair of links.
        groups: (G,3) first link, second link, index of the first of their `pairs`.
        sizes: (G,) how many pairs belong to a group.
        ball_center: (L,3) m in the link's frame, middle of a ball around all spheres of the link.
        ball_radius: (L,) m, its radius; 0 for a link without spheres.
    """

    pairs: IntArray
    groups: IntArray
    sizes: IntArray
    ball_center: FloatArray
    ball_radius: FloatArray


class RobotArrays(NamedTuple):
    """Arrays of a robot for the compiled loops of the collision checks.

    Attributes:
        base: (4,4) pose of link 0.
        origins: (n,4,4) from link i to the frame of joint i + 1 at position zero.
        prismatic: (n,) whether a joint is.
        link: (S,) link of each sphere; those on link 0 are not checked against obstacles.
        center: (S,3) m in the link's frame.
        radius: (S,) m.
        lever: (S,n) m/rad, or without unit of a prismatic joint; see `RobotModel.levers`.
        groups: (G,3), as in `LinkPairs`, like the next four.
        sizes: (G,).
        pairs: (M,2).
        ball_center: (n+1,3) m.
        ball_radius: (n+1,) m.
    """

    base: FloatArray
    origins: FloatArray
    prismatic: BoolArray
    link: IntArray
    center: FloatArray
    radius: FloatArray
    lever: FloatArray
    groups: IntArray
    sizes: IntArray
    pairs: IntArray
    ball_center: FloatArray
    ball_radius: FloatArray


class SingleArrays(NamedTuple):
    """Arrays of a robot in single precision, for the compiled loops of the costs.

    Attributes:
        base: (4,4), as in `RobotArrays`, like the next five.
        origins: (n,4,4).
        prismatic: (n,).
        link: (S,).
        center: (S,3) m.
        radius: (S,) m.
        ball_center: (n+1,3) m.
        ball_radius: (n+1,) m.
        groups: (G,6) first link, second link, the range of their `pairs`, the range of their
            spheres in `of_groups`.
        pairs: (M,4) indices of two spheres among all, and among those of their group.
        of_groups: (R,) the spheres of each group that are in one of its pairs.
        most_spheres: of one group.
    """

    base: NDArray[np.float32]
    origins: NDArray[np.float32]
    prismatic: BoolArray
    link: IntArray
    center: NDArray[np.float32]
    radius: NDArray[np.float32]
    ball_center: NDArray[np.float32]
    ball_radius: NDArray[np.float32]
    groups: IntArray
    pairs: IntArray
    of_groups: IntArray
    most_spheres: int


@dataclass(frozen=True, eq=False)
class RobotModel:
    """A serial chain of n revolute or prismatic joints, its limits, and S spheres around it.

    Attributes:
        base: (4,4) pose of link 0 in the base frame.
        joint_origins: (n,4,4) from link i to the frame of joint i + 1 at position zero; the joint
            turns about that frame's z, or a prismatic one slides along it, and the moved frame is
            link i + 1.
        end_effector: (4,4) end-effector frame in the last link.
        lower: (n,) rad, or m of a prismatic joint: joint limits.
        upper: (n,) likewise.
        velocity: (n,) rad/s or m/s, joint velocity limits.
        spheres: what must stay clear of obstacles; held objects belong to the last link.
        collision_pairs: (M,2) indices of spheres that must stay clear of each other.
        prismatic: (n,) whether a joint is; by default none.
    """

    base: FloatArray
    joint_origins: FloatArray
    end_effector: FloatArray
    lower: FloatArray
    upper: FloatArray
    velocity: FloatArray
    spheres: SphereSet
    collision_pairs: IntArray
    prismatic: BoolArray = field(default_factory=lambda: np.zeros(0, np.bool_))

    def __post_init__(self) -> None:
        n = len(self.joint_origins)
        shapes: dict[str, tuple[int, ...]] = {
            "base": (4, 4),
            "joint_origins": (n, 4, 4),
            "end_effector": (4, 4),
            "lower": (n,),
            "upper": (n,),
            "velocity": (n,),
        }
        for name, shape in shapes.items():
            object.__setattr__(self, name, _finite(name, getattr(self, name), shape))
        prismatic = np.array(self.prismatic, np.bool_)
        if prismatic.shape == (0,):
            prismatic = np.zeros(n, np.bool_)
        if prismatic.shape != (n,):
            raise ValueError(f"prismatic must have shape ({n},), got {prismatic.shape}")
        object.__setattr__(self, "prismatic", prismatic)
        if not (self.lower < self.upper).all():
            raise ValueError(f"lower {self.lower} must be below upper {self.upper}")
        if not (self.velocity > 0).all():
            raise ValueError(f"velocity must be positive, got {self.velocity}")
        link = self.link
        if len(link) and not (link.min() >= 0 and link.max() <= n):
            raise ValueError(f"spheres must be on links 0 to {n}, got {link.min()} to {link.max()}")
        if (self.radius < 0).any():
            raise ValueError(f"spheres.radius must not be negative, got {self.radius.min()}")
        pairs = np.ascontiguousarray(self.collision_pairs, np.int64).reshape(-1, 2)
        if len(pairs) and not (pairs.min() >= 0 and pairs.max() < len(link)):
            raise ValueError(
                f"collision_pairs must index the {len(link)} spheres, got {pairs.min()} to "
                f"{pairs.max()}"
            )
        object.__setattr__(self, "collision_pairs", pairs)

    def __repr__(self) -> str:
        """Return a short description, without the arrays."""
        return f"RobotModel({self.joints} joints, {len(self.link)} spheres)"

    @property
    def joints(self) -> int:
        """Number of joints n."""
        return len(self.joint_origins)

    @property
    def endless(self) -> NDArray[np.bool_]:
        """(n,) true for revolute joints with a range of more than a turn."""
        return np.asarray((self.upper - self.lower > 2 * np.pi) & ~self.prismatic)

    @property
    def units(self) -> tuple[str, ...]:
        """(n) units of the joints' positions, "rad" or "m"."""
        return tuple("m" if slides else "rad" for slides in self.prismatic)

    @cached_property
    def link(self) -> IntArray:
        """(S,) link of each sphere."""
        return np.array(self.spheres.link, np.int64)

    @cached_property
    def center(self) -> FloatArray:
        """(S,3) m, centre of each sphere in its link's frame."""
        return _finite("spheres.center", self.spheres.center, (len(self.link), 3))

    @cached_property
    def radius(self) -> FloatArray:
        """(S,) m, radius of each sphere."""
        return _finite("spheres.radius", self.spheres.radius, (len(self.link),))

    @cached_property
    def link_pairs(self) -> LinkPairs:
        """`collision_pairs` in the order in which the compiled loops go through them."""
        count = self.joints + 1
        ball_center = np.zeros((count, 3))
        ball_radius = np.zeros(count)
        for k in range(count):
            on_link = self.link == k
            if on_link.any():
                center, radius = self.center[on_link], self.radius[on_link]
                low = (center - radius[:, None]).min(axis=0)
                high = (center + radius[:, None]).max(axis=0)
                ball_center[k] = (low + high) / 2
                reach = np.linalg.norm(center - ball_center[k], axis=1) + radius
                ball_radius[k] = reach.max()
        # The link nearer to the base first, so that two orders of the same pair share a group.
        swap = self.link[self.collision_pairs[:, 0]] > self.link[self.collision_pairs[:, 1]]
        pairs = np.where(swap[:, None], self.collision_pairs[:, ::-1], self.collision_pairs)
        links = self.link[pairs].reshape(-1, 2)
        order = np.lexsort((links[:, 1], links[:, 0]))
        names, first, sizes = np.unique(links[order], axis=0, return_index=True, return_counts=True)
        return LinkPairs(
            pairs=np.ascontiguousarray(pairs[order]),
            groups=np.column_stack([names, first]).astype(np.int64).reshape(-1, 3),
            sizes=sizes.astype(np.int64),
            ball_center=ball_center,
            ball_radius=ball_radius,
        )

    @cached_property
    def levers(self) -> FloatArray:
        """(S,n) m/rad: within the limits, no sphere is ever farther from the axis of a joint.

        By the triangle inequality, from the sphere inwards; 0 if the joint does not move it. A
        prismatic joint moves by 1 m/m what is beyond it.
        """
        return self._levers(np.maximum(np.abs(self.lower), np.abs(self.upper)))

    def _levers(self, farthest: FloatArray) -> FloatArray:
        """Return `levers` for prismatic joints that are at most so far (n,) from zero, m."""
        origins = self.joint_origins[:, :3, 3]
        lever = np.zeros((len(self.link), self.joints))
        for s, (link, center) in enumerate(zip(self.link, self.center, strict=True)):
            beyond = 0.0
            for joint in range(link - 1, -1, -1):
                arm = center if joint == link - 1 else origins[joint + 1]
                if self.prismatic[joint]:
                    lever[s, joint] = 1.0
                    beyond += farthest[joint]
                else:
                    lever[s, joint] = math.hypot(arm[0], arm[1]) + beyond
                beyond += float(np.linalg.norm(arm))
        return lever

    @cached_property
    def arrays(self) -> RobotArrays:
        """Arrays for the compiled loops of the collision checks."""
        pairs = self.link_pairs
        return RobotArrays(
            self.base,
            self.joint_origins,
            self.prismatic,
            self.link,
            self.center,
            self.radius,
            self.levers,
            pairs.groups,
            pairs.sizes,
            pairs.pairs,
            pairs.ball_center,
            pairs.ball_radius,
        )

    def arrays_along(self, trajectories: FloatArray) -> RobotArrays:
        """Return `arrays` with levers that hold along trajectories (P, T, n), whatever the limits.

        Args:
            trajectories: rad or m; prismatic joints may be beyond their limits.
        """
        slides = self.prismatic
        if not slides.any() or not trajectories.size:
            return self.arrays
        farthest = np.maximum(np.abs(self.lower), np.abs(self.upper))
        reached = np.abs(trajectories).max(axis=(0, 1))
        if not (reached > farthest)[slides].any():
            return self.arrays
        return self.arrays._replace(lever=self._levers(np.maximum(farthest, reached)))

    @cached_property
    def least_gaps(self) -> FloatArray:
        """(M,) m, in the order of `link_pairs.pairs`: no posture brings the spheres nearer.

        Minus infinity where that is not known: where more than two joints are between the links,
        or one that is prismatic.
        The last joint before the outer sphere takes it round a circle, whose distance from a point
        is known; over the angle of a joint before that the least is found by steps, less what the
        inner sphere can come nearer between two of them.
        """
        pairs = self.link_pairs.pairs
        between = np.diff(self.link[pairs], axis=1)[:, 0]
        gaps = np.full(len(pairs), -np.inf)
        angle = np.arange(_STEPS_OF_A_TURN) * (2.0 * np.pi / _STEPS_OF_A_TURN)
        zero = np.zeros_like(angle)
        turned = np.stack([np.cos(angle), np.sin(angle), zero, -np.sin(angle), np.cos(angle), zero])
        turned = np.stack([*turned, zero, zero, zero + 1.0]).T.reshape(-1, 3, 3)
        slides = np.append(0, np.cumsum(self.prismatic))
        turned_only = np.diff(slides[self.link[pairs]], axis=1)[:, 0] == 0
        for g in np.flatnonzero(((between == 1) | (between == 2)) & turned_only):
            inner, outer = pairs[g]
            first = self.joint_origins[self.link[inner]]
            # The inner sphere in the frame of the next joint, on which that turns backwards.
            point = (self.center[inner] - first[:3, 3]) @ first[:3, :3]
            nearer = 0.0
            if between[g] == 2:
                second = self.joint_origins[self.link[inner] + 1]
                nearer = math.hypot(point[0], point[1]) * np.pi / _STEPS_OF_A_TURN
                point = (turned @ point - second[:3, 3]) @ second[:3, :3]
            x, y, z = self.center[outer]
            away = np.hypot(
                np.hypot(point[..., 0], point[..., 1]) - math.hypot(x, y), point[..., 2] - z
            )
            gaps[g] = float(away.min()) - nearer - self.radius[inner] - self.radius[outer]
        return gaps

    def single(self, reach: float = -np.inf) -> SingleArrays:
        """Return arrays for the compiled loops of the costs.

        Args:
            reach: m, gap from which on a pair of spheres does not matter; pairs that are never
                nearer are left out. By default, all.
        """
        found = self.link_pairs
        kept = self.least_gaps < reach if reach > -np.inf else np.zeros(len(found.pairs), np.bool_)
        spheres: list[IntArray] = []
        groups, pairs = [], [np.empty((0, 4), np.int64)]
        first_pair = first_sphere = 0
        for (i, j, begin), size in zip(found.groups, found.sizes, strict=True):
            stretch = slice(begin, begin + size)
            of_group = found.pairs[stretch][kept[stretch]]
            if not len(of_group):
                continue
            own, place = np.unique(of_group, return_inverse=True)
            pairs.append(np.hstack([of_group, place.reshape(-1, 2)]))
            spheres.append(own)
            last_pair, last_sphere = first_pair + len(of_group), first_sphere + len(own)
            groups.append((i, j, first_pair, last_pair, first_sphere, last_sphere))
            first_pair, first_sphere = last_pair, last_sphere
        return SingleArrays(
            self.base.astype(np.float32),
            self.joint_origins.astype(np.float32),
            self.prismatic,
            self.link,
            self.center.astype(np.float32),
            self.radius.astype(np.float32),
            found.ball_center.astype(np.float32),
            found.ball_radius.astype(np.float32),
            np.array(groups, np.int64).reshape(-1, 6),
            np.ascontiguousarray(np.concatenate(pairs)),
            np.concatenate([np.empty(0, np.int64), *spheres]),
            max((len(own) for own in spheres), default=0),
        )

    def carried(self, point: Any) -> FloatArray:
        """Return (3,) m, in the last link's frame, of a point (3,) fixed in the end-effector frame.

        Raises:
            ValueError: the point is not three finite numbers.
        """
        x = _finite("point", point, (3,))
        return self.end_effector[:3, :3] @ x + self.end_effector[:3, 3]

    def carried_points(self, configurations: Any, point: Any) -> tuple[FloatArray, FloatArray]:
        """Return where the hand carries a point, and the derivative with respect to the joints.

        Args:
            configurations: (..., n) rad or m.
            point: (3,) m, fixed in the end-effector frame.

        Returns:
            (..., 3) m in the base frame, and (..., 3, n) m/rad, or without unit of a prismatic
            joint.

        Raises:
            ValueError: wrong shape, or not finite.
        """
        q = np.ascontiguousarray(configurations, np.float64)
        if q.ndim == 0 or q.shape[-1] != self.joints:
            raise ValueError(f"configurations must have shape (..., {self.joints}), got {q.shape}")
        _finite("configurations", q, q.shape)
        positions = np.ascontiguousarray(q.reshape(-1, self.joints).T)
        placed = np.empty((1, 3, positions.shape[1]))
        jacobians = np.empty((3, self.joints, positions.shape[1]))
        forward_kernels.carried_points(
            positions,
            self.prismatic,
            self.base,
            self.joint_origins,
            np.array([self.joints]),
            self.carried(point)[None],
            placed,
            jacobians,
        )
        batch = q.shape[:-1]
        return (
            placed[0].T.reshape(*batch, 3),
            np.moveaxis(jacobians, 2, 0).reshape(*batch, 3, self.joints),
        )

    def tool_rotations(self, configurations: Any) -> tuple[FloatArray, FloatArray]:
        """Return the orientation of the hand, and the axes about which the joints turn it.

        Args:
            configurations: (..., n) rad or m.

        Returns:
            (..., 3, 3) from the end-effector frame to the base frame, and (..., 3, n) unit axes in
            the base frame; zeros for prismatic joints, which turn nothing.

        Raises:
            ValueError: wrong shape, or not finite.
        """
        origin, moved = self.carried_points(configurations, np.zeros(3))
        carried = [self.carried_points(configurations, axis) for axis in np.eye(3)]
        columns = np.stack([point - origin for point, _ in carried], axis=-2)
        slopes = np.stack([jacobian - moved for _, jacobian in carried], axis=-3)
        # A joint's axis a moves each column c by a x c, and the sum of c x (a x c) is 2 a.
        axes = 0.5 * np.cross(columns[..., None, :], np.swapaxes(slopes, -1, -2)).sum(axis=-3)
        return np.swapaxes(columns, -1, -2), np.swapaxes(axes, -1, -2)

    def link_transforms(self, configurations: torch.Tensor) -> torch.Tensor:
        """Return the poses (..., n + 1, 4, 4) of all links, differentiable by autograd.

        The slow and plain product of the chain, in the dtype and on the device of the argument:
        the oracle of the compiled loops.

        Args:
            configurations: (..., n) rad or m.
        """
        q = configurations
        if q.ndim == 0 or q.shape[-1] != self.joints:
            raise ValueError(
                f"configurations must have shape (..., {self.joints}), got {tuple(q.shape)}"
            )

        def constant(value: FloatArray) -> torch.Tensor:
            return torch.tensor(value, dtype=q.dtype, device=q.device)

        cosine, sine = torch.cos(q), torch.sin(q)
        zero, one = torch.zeros_like(q[..., 0]), torch.ones_like(q[..., 0])
        pose = constant(self.base).expand(*q.shape[:-1], 4, 4)
        poses = [pose]
        for k in range(self.joints):
            c, s, d = cosine[..., k], sine[..., k], zero
            if self.prismatic[k]:
                c, s, d = one, zero, q[..., k]
            moved = torch.stack(
                [c, -s, zero, zero, s, c, zero, zero, zero, zero, one, d, zero, zero, zero, one],
                dim=-1,
            ).reshape(*q.shape[:-1], 4, 4)
            pose = pose @ constant(self.joint_origins[k]) @ moved
            poses.append(pose)
        return torch.stack(poses, dim=-3)

    def sphere_centers(self, configurations: torch.Tensor) -> torch.Tensor:
        """Return the centres (..., S, 3) m of all spheres in the base frame, by autograd.

        Args:
            configurations: (..., n) rad or m.
        """
        poses = self.link_transforms(configurations)
        poses = poses[..., torch.tensor(self.link, device=poses.device), :, :]
        center = torch.tensor(self.center, dtype=poses.dtype, device=poses.device)
        return (poses[..., :3, :3] @ center[..., None])[..., 0] + poses[..., :3, 3]


def jaco_model(attached: SphereSet | None = None) -> RobotModel:
    """Return the JACO j2s6s200 with its link spheres.

    Args:
        attached: spheres that move with the last link: fingers and a held object.
    """
    spheres = kinematics.arm_spheres()
    if attached is not None:
        spheres = kinematics.concatenate(spheres, attached)
    return jaco_of_spheres(spheres)


def jaco_of_spheres(spheres: SphereSet) -> RobotModel:
    """Return the JACO j2s6s200 with the given spheres in place of its own.

    Args:
        spheres: of arm, fingers and held objects, or a part of them.
    """
    return RobotModel(
        base=kinematics.BASE_TRANSFORM,
        joint_origins=kinematics.JOINT_ORIGINS,
        end_effector=kinematics.END_EFFECTOR,
        lower=kinematics.JOINT_LOWER,
        upper=kinematics.JOINT_UPPER,
        velocity=kinematics.JOINT_VELOCITY,
        spheres=spheres,
        collision_pairs=kinematics.self_collision_pairs(spheres),
    )
