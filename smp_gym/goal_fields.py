"""Goals of a scene as fields of the desired goal, and back, for each task."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smp_gym.scene import Goal, Scene

__all__ = ["demanded", "goals_from"]

Array = NDArray[np.float64]


def _place(scene: Scene, index: int) -> tuple[float, float, float]:
    """Return where the object's centre shall rest to reach goal `index`."""
    if scene.manipulated is None:
        raise ValueError(f"a scene of {scene.task} needs a manipulated object, got None")
    x, y, z = scene.goals[index].position
    return (x, y, z + scene.manipulated.size[2])


def _place_demanded(scene: Scene) -> dict[str, Any]:
    """Return the desired goal of a task that sets an object down: where its centre shall rest."""
    position = _place(scene, 0)
    return {"object_position": position, "collided": 0.0, "released": 1.0, "at_rest": 1.0}


def _place_goals(desired: Mapping[str, Array], size: Array) -> tuple[Goal, ...]:
    """Return the goals that `_place_demanded` encoded, for an object of half-extents (3,)."""
    x, y, z = desired["object_position"].tolist()
    return (Goal(position=(x, y, z - float(size[2]))),)


def _double_sided_demanded(scene: Scene) -> dict[str, Any]:
    """Return the desired goal of a task that sets an object down on either of two pads."""
    return {
        "object_position_left": _place(scene, 0),
        "object_position_right": _place(scene, 1),
        "collided": 0.0,
        "released": 1.0,
        "at_rest": 1.0,
    }


def _double_sided_goals(desired: Mapping[str, Array], size: Array) -> tuple[Goal, ...]:
    """Return the goals that `_double_sided_demanded` encoded, for half-extents (3,)."""
    goals = []
    for side in ("left", "right"):
        x, y, z = desired[f"object_position_{side}"].tolist()
        goals.append(Goal(kind="pad", position=(x, y, z - float(size[2]))))
    return tuple(goals)


def _stroke_demanded(scene: Scene) -> dict[str, Any]:
    """Return the desired goal of a task that draws."""
    stroke = scene.goals[0]
    demanded = [float(flag) for flag in stroke.demanded]
    return {"stroke": np.ravel(stroke.checkpoints), "demanded": demanded, "collided": 0.0}


def _stroke_goals(desired: Mapping[str, Array], size: Array) -> tuple[Goal, ...]:
    """Return the goals that `_stroke_demanded` encoded."""
    points = tuple((x, y, z) for x, y, z in desired["stroke"].reshape(-1, 3).tolist())
    demanded = tuple(bool(flag > 0.5) for flag in desired["demanded"])
    return (Goal(kind="stroke", position=points[-1], checkpoints=points, demanded=demanded),)


def _lift_demanded(scene: Scene) -> dict[str, Any]:
    """Return the desired goal of a task that holds an object up: where its centre shall be."""
    return {"object_position": scene.goals[0].position, "collided": 0.0, "held": 1.0}


def _lift_goals(desired: Mapping[str, Array], size: Array) -> tuple[Goal, ...]:
    """Return the goals that `_lift_demanded` encoded."""
    x, y, z = desired["object_position"].tolist()
    return (Goal(kind="lift", position=(x, y, z)),)


_DEMANDED = {
    "Placement": _place_demanded,
    "DoubleSidedPlacement": _double_sided_demanded,
    "DrawS": _stroke_demanded,
    "PushLiftBox": _lift_demanded,
}
_GOALS = {
    "Placement": _place_goals,
    "DoubleSidedPlacement": _double_sided_goals,
    "DrawS": _stroke_goals,
    "PushLiftBox": _lift_goals,
}


def demanded(scene: Scene) -> dict[str, Any]:
    """Return the values of the desired goal by field name (`smp_gym.observation.GOAL_LAYOUTS`).

    Raises:
        ValueError: the scene lacks the object that the task needs.
    """
    return _DEMANDED[scene.task](scene)


def goals_from(task: str, desired: Mapping[str, Array], size: Array) -> tuple[Goal, ...]:
    """Return the goals that `demanded` encoded.

    Args:
        task: name of the task.
        desired: values of the desired goal by field name.
        size: (3,) half-extents of the object, m.
    """
    return _GOALS[task](desired, size)
