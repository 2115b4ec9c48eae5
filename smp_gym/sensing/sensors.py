"""The sensors: what an observation says of obstacles, given how they truly stand.

The errors of a sensor are drawn once for an episode, as a pure function of its scene: every method,
and every replay, perceives the same. Where obstacles move, what is perceived is the truth of the
moment with these same errors.
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
    "SIZE_ERROR",
    "ExactSensor",
    "NoisySensor",
    "RayCaster",
    "Sensor",
    "check_sensing",
    "scene_generator",
]

DEFAULT_NOISE = 0.02
"""Standard deviation of perceived positions along each axis, m."""

SIZE_ERROR = 0.1
"""Largest error of perceived sizes, as a share of the true ones."""

_ROW_ERRORS = 1
"""Stream of `scene_generator`."""


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
        period: environment steps from one look at moving obstacles to the next.
    """

    period: int

    def begin(self, scene: Scene) -> None:
        """Draw the errors of an episode, a pure function of its scene.

        Raises:
            ValueError: the sensor cannot work in this scene; the last episode's errors stay.
        """
        ...

    def perceive(
        self, obstacles: tuple[Obstacle, ...], world: RayCaster
    ) -> tuple[Obstacle, ...] | FloatArray:
        """Return what is perceived now: obstacles, or points (M, 3) m of their surfaces.

        Args:
            obstacles: all of the scene's, in its order, as they truly stand now.
            world: in which they stand.
        """
        ...


def scene_generator(scene: Scene, stream: int) -> np.random.Generator:
    """Return a source of randomness that depends on the scene's content alone.

    Args:
        scene: from whose JSON the seed is made.
        stream: tells sources for different uses apart.
    """
    digest = hashlib.blake2b(scene.to_json().encode(), digest_size=8).digest()
    return np.random.default_rng([int.from_bytes(digest, "little"), stream])


class ExactSensor:
    """Perceives obstacles as they are."""

    period = 1

    def begin(self, scene: Scene) -> None:
        """Draw nothing; see `Sensor`."""

    def perceive(self, obstacles: tuple[Obstacle, ...], world: RayCaster) -> tuple[Obstacle, ...]:
        """Return the obstacles; see `Sensor`."""
        return obstacles


class NoisySensor:
    """Perceives obstacles with errors of position and size.

    Positions are off by N(0, `noise`) along each axis; half-extents by one factor for each
    obstacle, uniform from 1 - `SIZE_ERROR` to 1 + `SIZE_ERROR`. Both stay for the episode.

    Args:
        noise: m, not negative.
    """

    period = 1

    def __init__(self, noise: float) -> None:
        self._noise = noise
        self._shift, self._factor = np.empty((0, 3)), np.empty(0)

    def begin(self, scene: Scene) -> None:
        """Draw the errors of the scene's obstacles; see `Sensor`."""
        rng = scene_generator(scene, _ROW_ERRORS)
        count = len(scene.obstacles)
        self._shift = self._noise * rng.standard_normal((count, 3))
        self._factor = rng.uniform(1.0 - SIZE_ERROR, 1.0 + SIZE_ERROR, count)

    def perceive(self, obstacles: tuple[Obstacle, ...], world: RayCaster) -> tuple[Obstacle, ...]:
        """Return the obstacles with the episode's errors; see `Sensor`."""
        return tuple(
            Obstacle(
                shape=obstacle.shape,
                position=tuple((np.array(obstacle.position) + shift).tolist()),
                quaternion=obstacle.quaternion,
                size=tuple(
                    REGISTRY[obstacle.shape].fitted(factor * np.array(obstacle.size)).tolist()
                ),
                velocity=obstacle.velocity,
            )
            for obstacle, shift, factor in zip(obstacles, self._shift, self._factor, strict=True)
        )


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
