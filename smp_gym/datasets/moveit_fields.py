"""Fields of MoveIt's messages as values: lists, numbers, poses, frames; errors name the field."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from smp_gym.arrays import FloatArray, shown
from smp_gym.geometry.pose import Pose

__all__ = [
    "WORLD",
    "as_list",
    "as_mapping",
    "as_number",
    "as_pose",
    "as_transform",
    "as_vector",
    "frame_in_header",
    "frame_name",
    "named_values",
    "stays",
]

WORLD = "world"
"""Frame of what names none."""

_NORM_TOLERANCE = 0.01
"""Largest deviation of an orientation's norm from 1: files have it rounded to three digits."""

_MOVED = 1e-6
"""m or rad by which the base of a robot may be moved and stand where it is."""


def as_mapping(value: Any, where: str) -> Mapping[str, Any]:
    """Return a field that is a mapping."""
    if not isinstance(value, Mapping):
        raise ValueError(f"{where} must be a mapping, got {value!r:.60}")
    return value


def as_list(value: Any, where: str) -> Sequence[Any]:
    """Return a field that is a list; an empty one for None."""
    if value is None:
        return ()
    if isinstance(value, str) or not isinstance(value, Sequence):
        raise ValueError(f"{where} must be a list, got {value!r:.60}")
    return value


def named_values(
    entries: Mapping[str, Any], names: str, values: str, value: str, where: str
) -> list[tuple[Any, Any]]:
    """Return the pairs of two lists of a message: names, and a value (in words) for each."""
    given = as_list(entries.get(names), f"{where}.{names}")
    found = as_list(entries.get(values), f"{where}.{values}")
    if len(given) != len(found):
        raise ValueError(
            f"{where} must have a {value} for each of its {len(given)} names, got {len(found)}"
        )
    return list(zip(given, found, strict=True))


def as_number(value: Any, where: str) -> float:
    """Return a field that is a finite number."""
    # PyYAML takes 1e-05 for a text: YAML 1.1 wants a point in it.
    try:
        number = math.nan if isinstance(value, bool) else float(value)
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if not math.isfinite(number):
        raise ValueError(f"{where} must hold finite numbers, got {shown(value)}")
    return number


def as_vector(value: Any, names: str, where: str) -> FloatArray:
    """Return a vector that is written as a list, or as a mapping of these names."""
    if isinstance(value, Mapping) and set(names) <= set(value):
        value = [value[name] for name in names]
    entries = as_list(value, where)
    if len(entries) != len(names):
        raise ValueError(
            f"{where} must be [{', '.join(names)}] or a mapping of these, got {value!r:.60}"
        )
    return np.array([as_number(entry, where) for entry in entries])


def frame_name(name: Any) -> str:
    """Return the name of a frame without the slash of tf; `WORLD` for none."""
    return str(WORLD if name is None else name).lstrip("/") or WORLD


def frame_in_header(item: Mapping[str, Any], where: str) -> str:
    """Return the frame that the header of an object names."""
    return frame_name(as_mapping(item.get("header") or {}, f"{where}.header").get("frame_id"))


def as_pose(value: Any, where: str, shift: str = "position", turn: str = "orientation") -> Pose:
    """Return the pose of a field, its parts named as those of ``geometry_msgs/Pose``."""
    entries = as_mapping(value, where)
    position = as_vector(entries.get(shift, (0.0, 0.0, 0.0)), "xyz", f"{where}.{shift}")
    given = entries.get(turn, (0.0, 0.0, 0.0, 1.0))
    quaternion = as_vector(given, "xyzw", f"{where}.{turn}")
    norm = float(np.linalg.norm(quaternion))
    if abs(norm - 1.0) > _NORM_TOLERANCE:
        raise ValueError(f"{where}.{turn} must have norm 1, got {given!r} with norm {norm:.4g}")
    return Pose(Rotation.from_quat(quaternion), position)


def as_transform(value: Any, where: str) -> Pose:
    """Return the pose of a ``geometry_msgs/Transform``."""
    return as_pose(value, where, "translation", "rotation")


def stays(pose: Pose) -> bool:
    """Return whether a pose moves nothing."""
    return bool(np.abs(pose.position).max() <= _MOVED and pose.rotation.magnitude() <= _MOVED)
