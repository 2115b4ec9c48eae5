"""The sensors: what an observation says of obstacles, given how they truly stand.

The errors of a sensor are a pure function of the scene and of the step at which it looks: every
method, and every replay, perceives the same. One part of them stays for the episode, as that of a
calibration does. Rows have another part that is new at every look, so that looking again is worth
something; the camera, which takes much longer to look, has none.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from typing import Protocol

import numpy as np

from smp_gym.arrays import FloatArray
from smp_gym.geometry.registry import REGISTRY
from smp_gym.observation import SENSINGS
from smp_gym.scene import Obstacle, Scene

__all__ = [
    "DEFAULT_NOISE",
    "LOOK_SHARE",
    "SIZE_ERROR",
    "ExactSensor",
    "NoisySensor",
    "RayCaster",
    "Sensor",
    "check_sensing",
    "scene_generator",
    "scene_seed",
]

DEFAULT_NOISE = 0.02
"""Standard deviation of perceived positions along each axis, m."""

SIZE_ERROR = 0.1
"""Largest error of perceived sizes, as a share of the true ones."""

LOOK_SHARE = 0.5
"""Share of the variance of perceived positions that is drawn anew at every look."""

_ROW_ERRORS, _LOOK_ERRORS = 1, 3
"""Streams of `scene_generator`."""

_BLOCK = 200
"""Number of looks whose errors are drawn together, for one at a time would slow down the step."""


class RayCaster(Protocol):
    """A world in which rays can be cast: `smp_gym.physics.world.BulletWorld`."""

    def cast_rays(
        self, origin: Sequence[float], ends: FloatArray
    ) -> tuple[tuple[str, ...], FloatArray]:
        """Return what rays (N, 3) from one point meet first, and at which share (N,) of them."""
        ...


class Sensor(Protocol):
    """Protocol of sensors.

    Attributes:
        period: environment steps from one look to the next.
        varies: whether looks differ even where all obstacles stand.
    """

    period: int
    varies: bool

    def begin(self, scene: Scene) -> None:
        """Draw the errors of an episode, a pure function of its scene.

        Raises:
            ValueError: the sensor cannot work in this scene; the last episode's errors stay.
        """
        ...

    def perceive(
        self, obstacles: tuple[Obstacle, ...], world: RayCaster, step: int
    ) -> tuple[Obstacle, ...] | FloatArray:
        """Return what is perceived now: obstacles, or points (M, 3) m of their surfaces.

        Args:
            obstacles: all of the scene's, in its order, as they truly stand now.
            world: in which they stand.
            step: environment steps since the episode began.
        """
        ...


def scene_seed(scene: Scene) -> int:
    """Return a seed that depends on the scene's content alone, made from its JSON."""
    digest = hashlib.blake2b(scene.to_json().encode(), digest_size=8).digest()
    return int.from_bytes(digest, "little")


def scene_generator(scene: Scene, stream: int) -> np.random.Generator:
    """Return a source of randomness that depends on the scene's content alone.

    Args:
        scene: from which the seed is made.
        stream: tells sources for different uses apart.
    """
    return np.random.default_rng([scene_seed(scene), stream])


class ExactSensor:
    """Perceives obstacles as they are."""

    period = 1
    varies = False

    def begin(self, scene: Scene) -> None:
        """Draw nothing; see `Sensor`."""

    def perceive(
        self, obstacles: tuple[Obstacle, ...], world: RayCaster, step: int
    ) -> tuple[Obstacle, ...]:
        """Return the obstacles; see `Sensor`."""
        return obstacles


class NoisySensor:
    """Perceives obstacles with errors of position and size.

    A position is off by N(0, `noise`) along each axis, the sum of two parts: one stays for the
    episode, one is drawn at every look and has `LOOK_SHARE` of the variance. So the errors of two
    looks are correlated by 1 - `LOOK_SHARE`, and the mean of n looks is off by
    `noise` sqrt(1 - `LOOK_SHARE` + `LOOK_SHARE` / n). Half-extents are off by one factor for each
    obstacle, uniform from 1 - `SIZE_ERROR` to 1 + `SIZE_ERROR`, which stays for the episode.
    Velocities and quaternions are exact.

    Args:
        noise: m, not negative.
    """

    period = 1

    def __init__(self, noise: float) -> None:
        self._noise = noise
        self.varies = noise > 0.0
        self._seed, self._block = 0, -1
        self._shift, self._looks = np.empty((0, 3)), np.empty((0, 0, 3))
        self._sizes: tuple[tuple[float, ...], ...] = ()

    def begin(self, scene: Scene) -> None:
        """Draw the errors that stay; see `Sensor`."""
        self._seed, self._block = scene_seed(scene), -1
        rng = np.random.default_rng([self._seed, _ROW_ERRORS])
        count = len(scene.obstacles)
        self._shift = self._noise * math.sqrt(1.0 - LOOK_SHARE) * rng.standard_normal((count, 3))
        factors = rng.uniform(1.0 - SIZE_ERROR, 1.0 + SIZE_ERROR, count)
        self._sizes = tuple(
            tuple(REGISTRY[obstacle.shape].fitted(factor * np.array(obstacle.size)).tolist())
            for obstacle, factor in zip(scene.obstacles, factors, strict=True)
        )

    def perceive(
        self, obstacles: tuple[Obstacle, ...], world: RayCaster, step: int
    ) -> tuple[Obstacle, ...]:
        """Return the obstacles with the errors of a look; see `Sensor`."""
        true = np.array([obstacle.position for obstacle in obstacles]).reshape(-1, 3)
        seen = (true + self._shift + self._look(step)).tolist()
        return tuple(
            obstacle.model_copy(update={"position": tuple(place), "size": size, "motion": None})
            for obstacle, place, size in zip(obstacles, seen, self._sizes, strict=True)
        )

    def _look(self, step: int) -> FloatArray:
        """Return the errors (N, 3) m of one look alone."""
        block, index = divmod(step, _BLOCK)
        if block != self._block:
            rng = np.random.default_rng([self._seed, _LOOK_ERRORS, block])
            deviation = self._noise * math.sqrt(LOOK_SHARE)
            self._looks = deviation * rng.standard_normal((_BLOCK, *self._shift.shape))
            self._block = block
        return np.asarray(self._looks[index])


def check_sensing(sensing: str, noise: float | None) -> float:
    """Check the arguments of sensing and return the noise, m; 0 but for "noise".

    Args:
        sensing: one of `smp_gym.observation.SENSINGS`.
        noise: m; None takes `DEFAULT_NOISE` where it applies.

    Raises:
        ValueError: no such sensing; noise that is negative, not finite or no number, or given where
            it does not apply.
    """
    if sensing not in SENSINGS:
        raise ValueError(f"sensing must be one of {', '.join(SENSINGS)}; got {sensing!r}")
    if noise is None:
        return DEFAULT_NOISE if sensing == "noise" else 0.0
    if sensing != "noise":
        raise ValueError(f"noise goes with sensing='noise' only, got {noise!r} and {sensing!r}")
    if isinstance(noise, bool) or not isinstance(noise, int | float | np.floating):
        raise ValueError(f"noise must be a number of metres, got {noise!r}")
    if not (math.isfinite(noise) and noise >= 0.0):
        raise ValueError(f"noise must be finite and not negative, m, got {noise!r}")
    return float(noise)
