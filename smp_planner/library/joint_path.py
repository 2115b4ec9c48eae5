"""A robot's path as a function of its length: the cubic spline through its samples."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline, PchipInterpolator

from smp_gym.arrays import FloatArray, checked_array, checked_number, shown

__all__ = ["JointPath"]

_LEAST_STEP = 0.25
"""Least distance between two samples of a path that are gone through, as a share of the mean one:
where a movement begins and ends, samples lie so close that their rounding bends the path."""

_ASIDE = 0.02
"""Share of a velocity that may be across the path, about a degree: directions that are known from
samples, or from a path that was cut here, are no closer."""


class JointPath:
    """A path of n joints by its length, 0 to `length`, the sum of its chords.

    Along its length a path nowhere stands still, as it may along the phase. It is in rad, or in m
    if all joints are prismatic; where both occur, a metre counts as much as a radian.

    Args:
        path: (T, n) rad or m, T ≥ 2, at equal steps of phase. Where samples lie much closer than
            elsewhere, some are left out.
        dimension: n.
        units: (n) of its joints, "rad" or "m"; "rad" for all by default.

    Attributes:
        unit: of velocities along it but for the second, for messages.
        samples: (K, n) rad or m, those that are gone through.
        knots: (K,) rad, the length up to each of them.
        phases: (K,) the phase of each of them.
        spline: of the samples over their knots.

    Raises:
        ValueError: no such array, or all samples are the same.
    """

    def __init__(self, path: Any, dimension: int, units: Sequence[str] = ("rad",)) -> None:
        self.unit = " and ".join(sorted(set(units), reverse=True))
        path = checked_array("path", path, (None, dimension))
        if len(path) < 2 or not (path != path[0]).any():
            raise ValueError("path must have at least two samples that differ")
        length = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1)))
        kept = _spaced(length)
        self.samples = path[kept]
        self.knots = length[kept]
        self.phases = np.array(kept) / (len(path) - 1)
        rising = np.append(True, np.diff(length) > 0.0)
        # Where it ends standing still, its last samples are one, at the phase of the end.
        self._demonstrated = length[rising], np.flatnonzero(rising) / (len(path) - 1)
        self._demonstrated[1][-1] = 1.0
        self.spline = CubicSpline(self.knots, self.samples)

    @property
    def length(self) -> float:
        """Length of the whole path, rad."""
        return float(self.knots[-1])

    def phase(self, lengths: FloatArray) -> FloatArray:
        """Return the phase at lengths."""
        return np.asarray(np.interp(lengths, *self._demonstrated))

    def demonstrated_speed(self, lengths: FloatArray, duration: float) -> FloatArray:
        """Return the speed along the path, rad/s, if its phase rose evenly in a duration, s."""
        slope = PchipInterpolator(*self._demonstrated)(lengths, 1)
        with np.errstate(divide="ignore"):
            return np.asarray(1.0 / (duration * slope))

    def tangent(self, *, end: bool) -> FloatArray:
        """Return the derivative (n,) by length where the path begins or ends."""
        return np.asarray(self.spline(self.length if end else 0.0, 1))

    def speed(self, name: str, velocity: Any, *, end: bool) -> float:
        """Return the rate of the length, rad/s, of a velocity where the path begins or ends.

        Args:
            name: of the argument, for the message.
            velocity: rad/s or m/s, of the joints (n,), or its norm; where both units occur, only 0
                is a norm.
            end: whether it is that of the end.

        Raises:
            ValueError: not such numbers, or not along the path.
        """
        tangent = self.tangent(end=end)
        norm = float(np.linalg.norm(tangent))
        if np.ndim(velocity) == 0:
            speed = checked_number(name, velocity, least=0.0) / norm
            if speed > 0.0 and " and " in self.unit:
                raise ValueError(
                    f"{name} must be 0 or have {len(tangent)} entries for joints in {self.unit}, "
                    f"got {shown(velocity)}"
                )
            return speed
        given = checked_array(name, velocity, (len(tangent),))
        speed = float(given @ tangent) / norm**2
        if np.linalg.norm(given - speed * tangent) > _ASIDE * np.linalg.norm(given) or speed < 0.0:
            raise ValueError(
                f"{name} must be along the path, whose direction there is "
                f"{(tangent / norm).round(4).tolist()}, up to a share of {_ASIDE} across it, got "
                f"{shown(velocity)}"
            )
        return speed

    def moved(
        self, length: FloatArray, speed: FloatArray, acceleration: FloatArray, jerk: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return positions, velocities, accelerations and jerks (N, n) of a progress along it.

        Args:
            length: (N,) rad, how far it is gone through.
            speed: (N,) rad/s, its first derivative in time.
            acceleration: (N,) rad/s², its second.
            jerk: (N,) rad/s³, its third.
        """
        first, second, third = (self.spline(length, order) for order in (1, 2, 3))
        v, a, j = speed[:, None], acceleration[:, None], jerk[:, None]
        return (
            self.spline(length),
            first * v,
            second * v**2 + first * a,
            third * v**3 + 3.0 * second * v * a + first * j,
        )


def _spaced(length: FloatArray) -> list[int]:
    """Return samples of a path that are not too close, both ends among them."""
    least = _LEAST_STEP * length[-1] / (len(length) - 1)
    kept = [0]
    for sample in range(1, len(length)):
        if length[sample] - length[kept[-1]] >= least:
            kept.append(sample)
    if length[-1] - length[kept[-1]] > 0.0:
        # In place of one that is too close to it.
        kept[1 if len(kept) == 1 else -1 :] = [len(length) - 1]
    return kept
