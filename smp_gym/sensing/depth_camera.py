"""A depth camera: points of the surfaces that it sees, with the errors of structured light.

Rays are cast in the physics world. All bodies hide what is behind them, but only points of
obstacles are kept: table, arm, goals and object are known. Then the errors come:

- along each ray, normal with a standard deviation that grows with the square of the distance, as
  measured for structured light (Khoshelham & Elberink 2012: about 1.425e-5 Z^2, Z in cm, so
  2 mm at 1.2 m and 3.6 cm at 5 m);
- of the points, a share is lost in patches, as where a surface shines, is dark, or is hidden;
- of what is left, at most `CLOUD_POINTS` are kept, spread evenly (farthest point sampling).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.ndimage import gaussian_filter

from smp_gym.arrays import BoolArray, FloatArray
from smp_gym.compiling import kernel
from smp_gym.geometry.distance import PackedObstacles, signed_distance
from smp_gym.observation import CLOUD_POINTS
from smp_gym.scene import Obstacle, Scene, fixtures
from smp_gym.sensing.sensors import RayCaster, scene_generator

__all__ = [
    "CAMERA_POSITION",
    "CAMERA_TARGET",
    "LOST_SHARE",
    "DepthCamera",
    "DepthSensor",
    "depth_deviation",
]

CAMERA_POSITION = (1.35, 0.30, 1.00)
"""Where the camera stands, m: before the arm, aside and above, looking over the workspace."""

CAMERA_TARGET = (0.42, 0.02, 0.25)
"""Point in the middle of its picture, m."""

_POSE_SPREAD = 0.02
"""Largest change of both from scene to scene, along each axis, m."""

LOST_SHARE = 0.3
"""Share of the seen points that is lost."""

_WIDTH, _HEIGHT = 128, 96
"""Rays; neighbours are 9 mm apart at the target."""

_FIELD_OF_VIEW = np.deg2rad(46.0)
"""Vertical opening, as of common depth cameras."""

_RANGE = 2.5
"""Length of the rays, m."""

_PATCH_WIDTH = 2.5
"""Pixels; standard deviation of the filter that makes patches out of white noise."""

_DEVIATION_PER_SQUARE = 1.425e-3
"""1/m; see above."""

_CAMERA_ERRORS = 2
"""Stream of `scene_generator`."""


def depth_deviation(distance: FloatArray) -> FloatArray:
    """Return the standard deviation (...) m of measured distances (...) m."""
    return np.asarray(_DEVIATION_PER_SQUARE * np.square(distance))


@dataclass(frozen=True, eq=False)
class DepthCamera:
    """A pinhole camera that measures distances.

    Attributes:
        position: (3,) m.
        target: (3,) m, in the middle of the picture.
    """

    position: FloatArray
    target: FloatArray

    def directions(self) -> FloatArray:
        """Return unit vectors (H, W, 3) of the rays, row by row from the upper left."""
        ahead = self.target - self.position
        ahead = ahead / np.linalg.norm(ahead)
        right = np.cross(ahead, [0.0, 0.0, 1.0])
        right = right / np.linalg.norm(right)
        down = np.cross(ahead, right)
        across, along = _pixels()
        rays = ahead + across[..., None] * right + along[..., None] * down
        return np.asarray(rays / np.linalg.norm(rays, axis=-1, keepdims=True))


@cache
def _pixels() -> tuple[FloatArray, FloatArray]:
    """Return how far (H, W) rays go aside and down for one ahead."""
    half = float(np.tan(_FIELD_OF_VIEW / 2))
    rows = half * (2.0 * (np.arange(_HEIGHT) + 0.5) / _HEIGHT - 1.0)
    columns = half * _WIDTH / _HEIGHT * (2.0 * (np.arange(_WIDTH) + 0.5) / _WIDTH - 1.0)
    across, along = np.meshgrid(columns, rows)
    return across, along


class DepthSensor:
    """Perceives points of the obstacles' surfaces; see the module.

    Camera pose, noise and patches are those of the camera for the whole episode. A look takes about
    as long as four steps of the physics, hence the period; at rest, one look serves the episode.
    """

    period = 4
    varies = False

    def __init__(self) -> None:
        self._camera = DepthCamera(np.array(CAMERA_POSITION), np.array(CAMERA_TARGET))
        self._rays = np.empty((0, 3))
        self._noise = self._field = np.empty(0)

    @property
    def camera(self) -> DepthCamera:
        """The camera as it stands in this episode."""
        return self._camera

    def begin(self, scene: Scene) -> None:
        """Draw camera pose, noise and patches; see `Sensor`.

        Raises:
            ValueError: the camera is inside a body.
        """
        rng = scene_generator(scene, _CAMERA_ERRORS)
        shift = rng.uniform(-_POSE_SPREAD, _POSE_SPREAD, (2, 3))
        camera = DepthCamera(CAMERA_POSITION + shift[0], CAMERA_TARGET + shift[1])
        bodies = [(f"obstacles[{i}]", body) for i, body in enumerate(scene.obstacles)]
        bodies += [("the table or a goal", body) for body in fixtures(scene)]
        for name, body in bodies:
            if signed_distance(camera.position, [body]) <= 0.0:
                raise ValueError(
                    f"the depth camera at {np.round(camera.position, 3).tolist()} must stand "
                    f"outside of all bodies, got {name} of the scene around it: {body!r}"
                )
        self._camera = camera
        self._rays = camera.directions().reshape(-1, 3)
        self._noise = rng.standard_normal(_HEIGHT * _WIDTH)
        white = rng.standard_normal((_HEIGHT, _WIDTH))
        self._field = gaussian_filter(white, _PATCH_WIDTH, mode="wrap").ravel()

    def perceive(self, obstacles: tuple[Obstacle, ...], world: RayCaster, step: int) -> FloatArray:
        """Return points (M, 3) m of surfaces, M at most `CLOUD_POINTS`; see `Sensor`."""
        # Other rays meet no obstacle, and of what else they meet nothing is kept.
        pixels = np.flatnonzero(_near(self._camera.position, self._rays, obstacles))
        if not len(pixels):
            return np.empty((0, 3))
        rays = self._rays[pixels]
        names, shares = world.cast_rays(
            self._camera.position.tolist(), self._camera.position + _RANGE * rays
        )
        seen = np.array([name.startswith("obstacle_") for name in names])
        pixels, rays, distance = pixels[seen], rays[seen], _RANGE * shares[seen]
        kept = np.sort(np.argsort(self._field[pixels], kind="stable")[_lost(len(pixels)) :])
        pixels, rays, distance = pixels[kept], rays[kept], distance[kept]
        distance = distance + depth_deviation(distance) * self._noise[pixels]
        points = self._camera.position + distance[:, None] * rays
        return points if len(points) <= CLOUD_POINTS else points[_spread(points, CLOUD_POINTS)]


def _lost(count: int) -> int:
    return round(LOST_SHARE * count)


def _near(origin: FloatArray, rays: FloatArray, obstacles: tuple[Obstacle, ...]) -> BoolArray:
    """Return which rays (N, 3) of length 1 pass through the bounding ball of an obstacle."""
    packed = PackedObstacles.of(obstacles)
    near = np.zeros(len(rays), np.bool_)
    for center, radius in zip(packed.position - origin, packed.bound, strict=True):
        along = rays @ center
        square = center @ center
        near |= (square - along * np.abs(along) < radius**2) | (square <= radius**2)
    return near


@kernel
def _spread(points, count):  # type: ignore[no-untyped-def]
    """Return indices (count,) of points (N, 3), each the farthest from those before it."""
    chosen = np.empty(count, np.int64)
    square = np.full(len(points), np.inf)
    last = 0
    for n in range(count):
        chosen[n] = last
        farthest = 0
        for i in range(len(points)):
            dx = points[i, 0] - points[last, 0]
            dy = points[i, 1] - points[last, 1]
            dz = points[i, 2] - points[last, 2]
            square[i] = min(square[i], dx * dx + dy * dy + dz * dz)
            if square[i] > square[farthest]:
                farthest = i
        last = farthest
    return chosen
