"""Objects that are attached to links of the robot in a MoveIt planning scene."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from smp_gym.arrays import shown
from smp_gym.datasets.moveit_fields import as_list, as_mapping
from smp_gym.datasets.moveit_scene import SceneBody, object_bodies

__all__ = ["AttachedObject", "attached_of"]


@dataclass(frozen=True, eq=False)
class AttachedObject:
    """An object that a robot holds, a ``moveit_msgs/AttachedCollisionObject``.

    Attributes:
        name: of the object.
        link: that it is attached to.
        touch_links: that it may touch, beside that link.
        bodies: its shapes, at least one.
    """

    name: str
    link: str
    touch_links: tuple[str, ...]
    bodies: tuple[SceneBody, ...]


def attached_of(state: Any, where: str) -> tuple[AttachedObject, ...]:
    """Return the objects that the robot holds in a ``moveit_msgs/RobotState``.

    Raises:
        ValueError: a field is wrong, an object names no link or no frame, has no shape, or stands
            there twice.
    """
    state = as_mapping(state or {}, where)
    where = f"{where}.attached_collision_objects"
    found: dict[str, AttachedObject] = {}
    for number, entry in enumerate(as_list(state.get("attached_collision_objects"), where)):
        attached = _attached(as_mapping(entry, f"{where}[{number}]"), f"{where}[{number}]")
        if attached.name in found:
            raise ValueError(f"{where} must hold each object once, got {attached.name!r} again")
        found[attached.name] = attached
    return tuple(found.values())


def _attached(item: Mapping[str, Any], where: str) -> AttachedObject:
    link = item.get("link_name")
    if not isinstance(link, str) or not link:
        raise ValueError(f"{where}.link_name must name a link, got {shown(link)}")
    held = as_mapping(item.get("object"), f"{where}.object")
    name = held.get("id")
    if not isinstance(name, str) or not name:
        raise ValueError(f"{where}.object.id must name the object, got {shown(name)}")
    touched = as_list(item.get("touch_links"), f"{where}.touch_links")
    for touch in touched:
        if not isinstance(touch, str) or not touch:
            raise ValueError(f"{where}.touch_links must be names of links, got {shown(touch)}")
    header = as_mapping(held.get("header") or {}, f"{name}.header")
    if not header.get("frame_id"):
        raise ValueError(
            f"{name}.header.frame_id must name the frame of its poses, such as {link!r}, got "
            f"{shown(header.get('frame_id'))}"
        )
    bodies = tuple(object_bodies(name, held))
    if not bodies:
        raise ValueError(f"{name} must have at least one shape where it is attached, got none")
    return AttachedObject(name, link, tuple(touched), bodies)
