"""The arm as numbers: chain, limits, link spheres, forward and inverse kinematics; no physics.

The arm is a Kinova JACO j2s6s200: six revolute joints, two fingers of two links each. The
constants are those of the manufacturer's robot description; `smp_gym.jaco_assets` writes
the simulated arm from the same numbers. Joint i turns LINKS[i + 1] about the z axis of its frame.
Metres, radians, seconds; poses are (4, 4) homogeneous matrices.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from smp_gym.assets import asset_path

__all__ = [
    "BASE_TRANSFORM",
    "END_EFFECTOR",
    "FINGER_JOINT_ORIGINS",
    "FINGER_TIP_ORIGIN",
    "GRASP_CENTER",
    "JOINT_LOWER",
    "JOINT_ORIGINS",
    "JOINT_UPPER",
    "JOINT_VELOCITY",
    "LINKS",
    "PEN_END",
    "PEN_RADIUS",
    "PEN_TIP",
    "REACH",
    "SHOULDER_HEIGHT",
    "SphereSet",
    "UnreachableError",
    "arm_spheres",
    "box_spheres",
    "concatenate",
    "end_effector_pose",
    "finger_spheres",
    "inverse_kinematics",
    "link_transforms",
    "pen_spheres",
    "self_collision_pairs",
    "sphere_centers",
]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


def _rotation(roll: float, pitch: float, yaw: float) -> FloatArray:
    """Return Rz(yaw) Ry(pitch) Rx(roll), the convention of URDF."""
    (cr, cp, cy), (sr, sp, sy) = np.cos((roll, pitch, yaw)), np.sin((roll, pitch, yaw))
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def _pose(xyz: tuple[float, float, float], rpy: tuple[float, float, float]) -> FloatArray:
    pose = np.eye(4)
    pose[:3, :3] = _rotation(*rpy)
    pose[:3, 3] = xyz
    return pose


def _constant(value: ArrayLike) -> FloatArray:
    array = np.array(value, np.float64)
    array.setflags(write=False)
    return array


LINKS = ("j2s6s200_link_base", *(f"j2s6s200_link_{i}" for i in range(1, 7)))
"""Links of the arm from base to hand; a link's index here is what `SphereSet.link` holds."""

JOINT_LOWER = _constant(
    [-2 * np.pi, np.radians(47), np.radians(19), -2 * np.pi, np.radians(30), -2 * np.pi]
)
JOINT_UPPER = _constant(
    [2 * np.pi, np.radians(313), np.radians(341), 2 * np.pi, np.radians(330), 2 * np.pi]
)
"""(6,) rad. Joints 1, 4 and 6 turn endlessly; they are held within a turn either way, unwrapped."""

JOINT_VELOCITY = _constant(np.radians([36.0, 36.0, 36.0, 48.0, 48.0, 48.0]))
"""(6,) rad/s, limits."""

BASE_TRANSFORM = _constant(_pose((0.0, 0.0, 0.0), (0.0, 0.0, np.pi / 2)))
"""(4, 4) LINKS[0] in the base frame."""

JOINT_ORIGINS = _constant(
    [
        _pose((0.0, 0.0, 0.15675), (0.0, np.pi, 0.0)),
        _pose((0.0, 0.0016, -0.11875), (-np.pi / 2, 0.0, np.pi)),
        _pose((0.0, -0.410, 0.0), (0.0, np.pi, 0.0)),
        _pose((0.0, 0.2073, -0.0114), (-np.pi / 2, 0.0, np.pi)),
        _pose((0.0, 0.0, -0.10375), (np.pi / 2, 0.0, np.pi)),
        _pose((0.0, 0.10375, 0.0), (-np.pi / 2, 0.0, np.pi)),
    ]
)
"""(6, 4, 4) frame of joint i + 1 at angle zero, in LINKS[i]."""

END_EFFECTOR = _constant(_pose((0.0, 0.0, -0.16), (np.pi, np.pi / 2, 0.0)))
"""(4, 4) end-effector frame in LINKS[6]: x approaches, the fingers open along y."""

GRASP_CENTER = _constant([0.022, 0.0, 0.0])
"""(3,) m, middle between the finger pads, in the end-effector frame."""

PEN_TIP = _constant([0.14, 0.0, 0.0])
"""(3,) m, point of the pen in the end-effector frame; the pen lies on the frame's x axis."""

REACH = float(
    np.linalg.norm(JOINT_ORIGINS[2:, :3, 3], axis=1).sum()
    + np.linalg.norm(END_EFFECTOR[:3, 3])
    + np.linalg.norm(PEN_TIP)
)
"""m from the shoulder (joint 2), farther than which no point of the hand or of the pen ever is."""

SHOULDER_HEIGHT = 0.2755
"""m, of joint 2, which is on the base's axis to within 2 mm."""

PEN_END = -0.02
PEN_RADIUS = 0.006
"""Metres: where the pen's other end lies on that axis, and how thick it is."""

_FINGER_TILT = 0.649262481663582
FINGER_JOINT_ORIGINS = _constant(
    [
        _pose((-0.0025, 0.03095, -0.11482), (-np.pi / 2, _FINGER_TILT, np.pi / 2)),
        _pose((-0.0025, -0.03095, -0.11482), (-np.pi / 2, _FINGER_TILT, -np.pi / 2)),
    ]
)
"""(2, 4, 4) proximal joints of fingers 1 and 2 in LINKS[6], at angle zero; they turn about z."""

FINGER_TIP_ORIGIN = _constant(_pose((0.044, -0.003, 0.0), (0.0, 0.0, 0.0)))
"""(4, 4) joint of a finger's tip in its proximal link, at angle zero; it turns about z."""

_FINGERS = ("j2s6s200_link_finger_1", "j2s6s200_link_finger_2")
_TIPS = ("j2s6s200_link_finger_tip_1", "j2s6s200_link_finger_tip_2")
_HAND = len(LINKS) - 1


class UnreachableError(ValueError):
    """A pose that the arm cannot take."""


def _checked(name: str, value: ArrayLike, shape: tuple[int, ...]) -> FloatArray:
    array = np.asarray(value, np.float64)
    if array.shape[-len(shape) :] != shape:
        wanted = ", ".join(map(str, shape))
        raise ValueError(f"{name} must have shape (..., {wanted}), got {array.shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"{name} must be finite, got {array}")
    return array


@dataclass(frozen=True, eq=False)
class SphereSet:
    """Spheres fixed to links.

    Attributes:
        link: (S,) index into `LINKS`.
        center: (S, 3) m, in the link's frame.
        radius: (S,) m.
    """

    link: IntArray
    center: FloatArray
    radius: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "link", np.asarray(self.link, np.int64))
        count = len(self.link)
        object.__setattr__(self, "center", np.asarray(self.center, np.float64).reshape(count, 3))
        object.__setattr__(self, "radius", np.asarray(self.radius, np.float64).reshape(count))

    def __len__(self) -> int:
        return len(self.link)


def concatenate(*sets: SphereSet) -> SphereSet:
    """Return all spheres of some sets, in order."""
    return SphereSet(
        np.concatenate([s.link for s in sets]),
        np.concatenate([s.center for s in sets]),
        np.concatenate([s.radius for s in sets]),
    )


def _turned(origins: FloatArray, angles: FloatArray) -> FloatArray:
    """Return joint frames (..., 4, 4) turned about their own z by angles (...)."""
    cosine, sine = np.cos(angles)[..., None], np.sin(angles)[..., None]
    x, y = origins[..., :, 0], origins[..., :, 1]
    turned = np.empty((*np.broadcast_shapes(x.shape, cosine.shape), 4))
    turned[..., 0] = cosine * x + sine * y
    turned[..., 1] = cosine * y - sine * x
    turned[..., 2:] = origins[..., :, 2:]
    return turned


def link_transforms(configurations: ArrayLike) -> FloatArray:
    """Return the poses (..., 7, 4, 4) of all `LINKS` in the base frame.

    Args:
        configurations: (..., 6) rad.

    Raises:
        ValueError: wrong shape, or not finite.
    """
    q = _checked("configurations", configurations, (6,))
    poses = np.empty((*q.shape[:-1], len(LINKS), 4, 4))
    poses[..., 0, :, :] = BASE_TRANSFORM
    for i in range(6):
        poses[..., i + 1, :, :] = _turned(poses[..., i, :, :] @ JOINT_ORIGINS[i], q[..., i])
    return poses


def end_effector_pose(configurations: ArrayLike) -> FloatArray:
    """Return the end-effector frame (..., 4, 4) in the base frame, for (..., 6) rad."""
    return np.asarray(link_transforms(configurations)[..., -1, :, :] @ END_EFFECTOR)


def sphere_centers(configurations: ArrayLike, spheres: SphereSet) -> FloatArray:
    """Return the centres (..., S, 3) m of spheres in the base frame.

    Args:
        configurations: (..., 6) rad.
        spheres: S spheres.
    """
    poses = link_transforms(configurations)[..., spheres.link, :, :]
    turned = (poses[..., :3, :3] @ spheres.center[..., None])[..., 0]
    return np.asarray(turned + poses[..., :3, 3])


@cache
def _sphere_data() -> dict[str, Any]:
    path = asset_path("jaco", "spheres.json")
    data = json.loads(path.read_text())
    if data.get("format") != "smp_gym.spheres" or data.get("version") != 1:
        raise ValueError(f"{path} must hold smp_gym.spheres version 1")
    return dict(data)


def _link_spheres(name: str) -> FloatArray:
    """Return (n, 4) centre and radius of the spheres of a link, in its frame."""
    return np.asarray(_sphere_data()["links"].get(name, []), np.float64).reshape(-1, 4)


@cache
def arm_spheres() -> SphereSet:
    """Return the spheres of base, arm and palm, which cover their collision shapes."""
    parts = []
    for index, name in enumerate(LINKS):
        data = _link_spheres(name)
        parts.append(SphereSet(np.full(len(data), index), data[:, :3], data[:, 3]))
    return concatenate(*parts)


def finger_spheres(finger_angles: ArrayLike) -> SphereSet:
    """Return the spheres of the fingers as they stand, fixed to the hand.

    Args:
        finger_angles: (4,) rad: proximal 1, proximal 2, tip 1, tip 2.

    Raises:
        ValueError: wrong shape, or not finite.
    """
    angles = _checked("finger_angles", finger_angles, (4,))
    centers, radii = [], []
    for i in range(2):
        proximal = _turned(FINGER_JOINT_ORIGINS[i], angles[i])
        tip = _turned(proximal @ FINGER_TIP_ORIGIN, angles[2 + i])
        for pose, name in ((proximal, _FINGERS[i]), (tip, _TIPS[i])):
            data = _link_spheres(name)
            centers.append(data[:, :3] @ pose[:3, :3].T + pose[:3, 3])
            radii.append(data[:, 3])
    center = np.concatenate(centers)
    return SphereSet(np.full(len(center), _HAND), center, np.concatenate(radii))


def box_spheres(half_extents: ArrayLike, pose: ArrayLike) -> SphereSet:
    """Return spheres that cover a box held in the hand.

    The box is cut into equal cells, about half as wide as its shortest side but not more than six
    along an axis; each cell lies in the ball through its corners.

    Args:
        half_extents: (3,) m, positive.
        pose: (4, 4) of the box in the end-effector frame.

    Raises:
        ValueError: wrong shape, not finite, or an extent is not positive.
    """
    half = _checked("half_extents", half_extents, (3,))
    placed = END_EFFECTOR @ _checked("pose", pose, (4, 4))
    if not (half > 0.0).all():
        raise ValueError(f"half_extents must be positive, got {half}")
    counts = np.ceil(half / max(half.min() / 2, half.max() / 6) - 1e-9).astype(int)
    axes = [h * ((2 * np.arange(n) + 1) / n - 1) for h, n in zip(half, counts, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    radius = float(np.linalg.norm(half / counts))
    center = points @ placed[:3, :3].T + placed[:3, 3]
    # A cell in the middle of the box is covered by nothing that sticks out: it only costs time.
    inner = (np.abs(points) < half - radius).all(axis=1)
    center = center[~inner]
    return SphereSet(np.full(len(center), _HAND), center, np.full(len(center), radius))


@cache
def pen_spheres() -> SphereSet:
    """Return the spheres of the pen that the hand draws with; they cover it."""
    count = 12
    step = (float(PEN_TIP[0]) - PEN_END) / count
    along = PEN_END + step * (np.arange(count) + 0.5)
    center = along[:, None] * END_EFFECTOR[:3, 0] + END_EFFECTOR[:3, 3]
    radius = np.full(count, np.hypot(step / 2, PEN_RADIUS))
    return SphereSet(np.full(count, _HAND), center, radius)


def self_collision_pairs(spheres: SphereSet) -> IntArray:
    """Return the index pairs (M, 2) of spheres whose links may not touch each other."""
    pairs = []
    for first, second in _sphere_data()["self_collision_links"]:
        if first in LINKS and second in LINKS:
            a = np.flatnonzero(spheres.link == LINKS.index(first))
            b = np.flatnonzero(spheres.link == LINKS.index(second))
            pairs.append(np.stack(np.meshgrid(a, b, indexing="ij"), axis=-1).reshape(-1, 2))
    return np.concatenate(pairs) if pairs else np.empty((0, 2), np.int64)


_SEED_LIBRARY = _constant(
    [
        [-0.8, 3.5, 1.0, 0.0, 2.7, 0.0],
        [-2.1, 3.8, 1.0, 0.0, 2.5, 0.0],
        [-1.6, 2.9, 1.3, 4.2, 1.4, 0.0],
        [-1.6, 3.4, 2.0, 1.5, 2.0, 1.5],
        [0.8, 3.2, 1.6, -1.5, 2.2, 0.0],
        [-3.0, 4.0, 1.6, 1.0, 3.6, 1.0],
        [-1.6, 2.4, 4.6, 3.0, 2.6, 0.0],
        [1.6, 3.6, 2.4, 0.0, 4.0, 3.0],
        [2.5, 1.8, 2.8, -2.0, 4.6, -1.5],
    ]
)
"""Configurations all over the workspace from which the search starts besides the caller's."""

_ITERATIONS = 200
_DAMPING = 1e-3
_LARGEST_STEP = 0.3
_ROTATION_LENGTH = 0.3
"""Metres that one radian of rotation error counts as."""


def _errors(poses: FloatArray, position: FloatArray, rotation: FloatArray | None) -> FloatArray:
    """Return (..., 3) position errors, or (..., 6) with scaled rotation vectors."""
    offset = position - poses[..., :3, 3]
    if rotation is None:
        return np.asarray(offset)
    turn = rotation @ np.swapaxes(poses[..., :3, :3], -1, -2)
    axis = np.stack(
        [
            turn[..., 2, 1] - turn[..., 1, 2],
            turn[..., 0, 2] - turn[..., 2, 0],
            turn[..., 1, 0] - turn[..., 0, 1],
        ],
        axis=-1,
    )
    sine = np.linalg.norm(axis, axis=-1)
    angle = np.arctan2(sine, np.trace(turn, axis1=-2, axis2=-1) - 1.0)
    # At half a turn the axis vanishes; the small number only keeps the division defined.
    vector = axis * (angle / np.maximum(sine, 1e-9))[..., None]
    return np.concatenate([offset, _ROTATION_LENGTH * vector], axis=-1)


def _jacobians(links: FloatArray, tool: FloatArray, with_rotation: bool) -> FloatArray:
    """Return (..., 3 or 6, 6) derivatives of the tool's pose, rotation scaled as in `_errors`."""
    axes = np.swapaxes(links[..., 1:, :3, 2], -1, -2)
    arms = tool[..., None, :3, 3] - links[..., 1:, :3, 3]
    linear = np.swapaxes(np.cross(links[..., 1:, :3, 2], arms), -1, -2)
    if not with_rotation:
        return np.asarray(linear)
    return np.concatenate([linear, _ROTATION_LENGTH * axes], axis=-2)


def _unwrapped(solutions: FloatArray, seed: FloatArray) -> FloatArray:
    """Return solutions with endless joints at the turn nearest to the seed, within limits."""
    endless = [0, 3, 5]
    turns = np.round((seed[endless] - solutions[:, endless]) / (2 * np.pi))
    moved = solutions.copy()
    moved[:, endless] += 2 * np.pi * turns
    outside = (moved < JOINT_LOWER) | (moved > JOINT_UPPER)
    return np.where(outside, solutions, moved)


def inverse_kinematics(
    position: ArrayLike,
    rotation: ArrayLike | None = None,
    seed: ArrayLike | None = None,
    *,
    tolerance: float = 1e-5,
) -> FloatArray:
    """Return the configuration (6,) rad nearest to `seed` whose end effector is at a pose.

    Damped least squares on one batch of start configurations: the seed and a small library.

    Args:
        position: (3,) m, of the end-effector frame's origin in the base frame.
        rotation: (3, 3) of the end-effector frame, or None if any will do.
        seed: (6,) rad, near which a solution is wanted; default the first of the library.
        tolerance: m, largest error; a rotation error counts `_ROTATION_LENGTH` metres per radian.

    Raises:
        UnreachableError: no solution within the joint limits was found.
        ValueError: wrong shape, not finite, or `rotation` is not a rotation.
    """
    target = _checked("position", position, (3,))
    turn = None if rotation is None else _checked("rotation", rotation, (3, 3))
    if turn is not None and not (
        np.allclose(turn @ turn.T, np.eye(3), atol=1e-6) and np.linalg.det(turn) > 0
    ):
        raise ValueError(f"rotation must be a rotation matrix, got {turn}")
    near = _SEED_LIBRARY[0] if seed is None else _checked("seed", seed, (6,))
    q = np.clip(np.vstack([near, _SEED_LIBRARY]), JOINT_LOWER, JOINT_UPPER)
    for _ in range(_ITERATIONS):
        links = link_transforms(q)
        tool = links[:, -1] @ END_EFFECTOR
        error = _errors(tool, target, turn)
        residual = np.linalg.norm(error, axis=-1)
        if (residual < tolerance).all() or residual[0] < 0.1 * tolerance:
            break
        jacobian = _jacobians(links, tool, turn is not None)
        transposed = np.swapaxes(jacobian, -1, -2)
        # Damping that fades with the error: steady far away, quadratic near the solution.
        damping = _DAMPING * np.minimum(residual, 0.1)[:, None, None] * np.eye(error.shape[-1])
        damping += 1e-9 * np.eye(error.shape[-1])
        step = (transposed @ np.linalg.solve(jacobian @ transposed + damping, error[..., None]))[
            ..., 0
        ]
        largest = np.abs(step).max(axis=-1, keepdims=True)
        q = np.clip(
            q + step * np.minimum(1.0, _LARGEST_STEP / np.maximum(largest, 1e-12)),
            JOINT_LOWER,
            JOINT_UPPER,
        )
    residual = np.linalg.norm(_errors(end_effector_pose(q), target, turn), axis=-1)
    solved = residual < tolerance
    if not solved.any():
        raise UnreachableError(
            f"position {target} is out of reach: the end effector stays {residual.min():.4f} m "
            f"{'' if turn is None else '(rotation included) '}away from it"
        )
    solutions = _unwrapped(q[solved], near)
    return np.asarray(solutions[np.abs(solutions - near).max(axis=1).argmin()])
