"""Where obstacles that move are expected: an observation, extrapolated, and a margin that grows."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from smp_gym.arrays import FloatArray
from smp_gym.geometry.distance import PackedObstacles
from smp_gym.scene import Obstacle

__all__ = ["Forecast", "checked_times", "is_moving"]

_LEAST_SPEED = 1e-3
"""m/s, below which a body counts as standing."""


def is_moving(obstacle: Obstacle) -> bool:
    """Return whether an obstacle is observed to move."""
    return math.hypot(*obstacle.velocity) > _LEAST_SPEED


@dataclass(frozen=True, eq=False)
class Forecast:
    """Where obstacles are expected after one observation of them, and how surely.

    A body goes on at its velocity, which turns at a constant rate where one is known, until the
    horizon; from then on it is taken to stay. Its margin grows with the distance that it is
    expected to have gone, up to a cap. A body that stands has none.

    Attributes:
        obstacles: as they were observed.
        turn: (N, 3) rad/s, at which their velocities turn.
        horizon: s, from which on they are taken to stay.
        growth: m of margin for each metre that a body has gone.
        most: m, largest margin.
        least: m, margin of what moves at the time of the observation: the arm follows its reference
            a little late.

    Raises:
        ValueError: `turn` does not fit the obstacles or is not finite, or a number is negative or
            not finite.
    """

    obstacles: tuple[Obstacle, ...]
    turn: FloatArray
    horizon: float
    growth: float
    most: float
    least: float = 0.0

    def __post_init__(self) -> None:
        turn = np.asarray(self.turn, np.float64)
        if turn.shape != (len(self.obstacles), 3) or not np.isfinite(turn).all():
            raise ValueError(
                f"turn must be ({len(self.obstacles)}, 3) finite numbers, got {self.turn!r}"
            )
        object.__setattr__(self, "turn", turn)
        for name in ("horizon", "growth", "most", "least"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0.0):
                raise ValueError(f"{name} must be finite and not negative, got {value}")
        object.__setattr__(self, "_packed", PackedObstacles.of(self.obstacles))

    @property
    def packed(self) -> PackedObstacles:
        """The obstacles as they were observed."""
        packed: PackedObstacles = self._packed  # type: ignore[attr-defined]
        return packed

    @property
    def speed(self) -> FloatArray:
        """(N,) m/s."""
        velocity = np.array([o.velocity for o in self.obstacles], np.float64).reshape(-1, 3)
        return np.asarray(np.linalg.norm(velocity, axis=1))

    def positions(self, times: ArrayLike) -> FloatArray:
        """Return where the centres are expected, (..., N, 3) m.

        Args:
            times: (...) s since the observation.
        """
        time = np.clip(np.asarray(times, np.float64), 0.0, self.horizon)[..., None, None]
        velocity = np.array([o.velocity for o in self.obstacles], np.float64).reshape(-1, 3)
        rate = np.linalg.norm(self.turn, axis=1, keepdims=True)
        axis = self.turn / np.where(rate > 0.0, rate, 1.0)
        along = (velocity * axis).sum(axis=1, keepdims=True) * axis
        across, sideways = velocity - along, np.cross(axis, velocity)
        angle = rate * time
        # The integral of a vector that turns: sin(a) / rate and (1 - cos(a)) / rate, finite at 0.
        forward = time * np.sinc(angle / np.pi)
        half = np.sinc(angle / (2.0 * np.pi))
        aside = 0.5 * rate * np.square(time) * np.square(half)
        moved = time * along + forward * across + aside * sideways
        return np.asarray(self.packed.position + moved)

    def margins(self, times: ArrayLike) -> FloatArray:
        """Return by how much bodies are enlarged, (..., N) m, at times (...) s."""
        time = np.clip(np.asarray(times, np.float64), 0.0, self.horizon)[..., None]
        speed = self.speed
        grown = np.where(speed > _LEAST_SPEED, self.least + self.growth * speed * time, 0.0)
        return np.asarray(np.minimum(grown, self.most))


def checked_times(times: ArrayLike, shape: tuple[int, ...]) -> FloatArray:
    """Return times as an array of a shape.

    Raises:
        ValueError: they have another, or are not finite.
    """
    array = np.asarray(times, np.float64)
    if array.shape != shape or not np.isfinite(array).all():
        raise ValueError(f"times must be {shape} finite numbers, got shape {array.shape}")
    return array
