"""Faces of obstacles, for drawing."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from smp_gym.arrays import FloatArray
from smp_gym.geometry.registry import REGISTRY
from smp_gym.scene import Obstacle

__all__ = ["body_faces"]


def body_faces(body: Obstacle) -> list[FloatArray]:
    """Return the polygons of a body in the base frame, each (V, 3) m."""
    rotation = Rotation.from_quat(body.quaternion).as_matrix()
    faces = REGISTRY[body.shape].faces(np.array(body.size))
    return [face @ rotation.T + body.position for face in faces]
