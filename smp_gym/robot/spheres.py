"""Spheres fixed to the arm's links, to its fingers and to what the hand holds."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from smp_gym.arrays import FloatArray, IntArray
from smp_gym.assets import asset_path
from smp_gym.robot.chain import (
    END_EFFECTOR,
    FINGER_JOINT_ORIGINS,
    FINGER_TIP_ORIGIN,
    LINKS,
    PEN_END,
    PEN_RADIUS,
    PEN_TIP,
    checked,
    link_transforms,
    turned,
)

__all__ = [
    "SphereSet",
    "arm_spheres",
    "box_spheres",
    "concatenate",
    "finger_spheres",
    "pen_spheres",
    "self_collision_pairs",
    "sphere_centers",
]

_FINGERS = ("j2s6s200_link_finger_1", "j2s6s200_link_finger_2")
_TIPS = ("j2s6s200_link_finger_tip_1", "j2s6s200_link_finger_tip_2")
_HAND = len(LINKS) - 1


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
    angles = checked("finger_angles", finger_angles, (4,))
    centers, radii = [], []
    for i in range(2):
        proximal = turned(FINGER_JOINT_ORIGINS[i], angles[i])
        tip = turned(proximal @ FINGER_TIP_ORIGIN, angles[2 + i])
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
    half = checked("half_extents", half_extents, (3,))
    placed = END_EFFECTOR @ checked("pose", pose, (4, 4))
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
