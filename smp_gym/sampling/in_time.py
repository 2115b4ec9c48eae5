"""Trajectories in time against obstacles that move: what they clear, and when they are executed.

Time is counted in ticks of `smp_gym.observation.CONTROL_PERIOD` since the episode began. A track is
the position of an obstacle at each tick of an episode; after its last the obstacle stays there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smp_gym.arrays import BoolArray, FloatArray
from smp_gym.compiling import kernel
from smp_gym.control import execution_time
from smp_gym.geometry import registry
from smp_gym.observation import CONTROL_PERIOD, MAX_EPISODE_STEPS
from smp_gym.sampling.kernels import point_distance
from smp_gym.sampling.witness import WITNESS_SAMPLES

__all__ = [
    "HOLD_SAMPLES",
    "TICKS",
    "Timing",
    "clears_in_time",
    "delayed",
    "held_on",
    "ticks_of",
]

TICKS = MAX_EPISODE_STEPS + 1
"""Length of a track: an episode's steps, and its beginning."""

HOLD_SAMPLES = 10
"""Samples of the end of a trajectory that follow it, while the arm stands there."""

_HOLD_TICKS = 5
"""Ticks between these: 2.5 s in all, in which what was let go has come to rest."""


@dataclass(frozen=True)
class Timing:
    """When the samples of a trajectory are passed.

    Attributes:
        duration: s, of the movement, the phase running evenly.
        pause: (phase, s): how long the arm stands still somewhere on the trajectory.
    """

    duration: float
    pause: tuple[float, float] = (1.0, 0.0)

    def times(self, samples: int) -> FloatArray:
        """Return (samples,) s at which equal steps of phase are passed."""
        phase = np.linspace(0.0, 1.0, samples)
        at, length = self.pause
        times: FloatArray = phase * self.duration + np.where(phase > at, length, 0.0)
        return times


def ticks_of(times: FloatArray) -> NDArray[np.int64]:
    """Return (..., T + `HOLD_SAMPLES`) ticks of (..., T) s, and of the hold that follows them."""
    ticks = np.rint(times / CONTROL_PERIOD).astype(np.int64)
    hold = ticks[..., -1:] + _HOLD_TICKS * np.arange(1, HOLD_SAMPLES + 1)
    return np.concatenate([ticks, hold], axis=-1)


def held_on(paths: FloatArray) -> FloatArray:
    """Return (..., T + `HOLD_SAMPLES`, S, 3) m: (..., T, S, 3) paths that stay where they end."""
    return np.concatenate([paths, np.repeat(paths[..., -1:, :, :], HOLD_SAMPLES, axis=-3)], axis=-3)


def delayed(trajectory: FloatArray, delay: float) -> FloatArray:
    """Return (200, 6) rad: a trajectory (T, 6) after so many seconds at its start.

    Executed at 0.9 times the velocity limits it takes so much longer, up to what sampling changes.
    """
    duration = execution_time(trajectory)
    times = np.linspace(0.0, delay + duration, WITNESS_SAMPLES)
    phase = np.maximum(times - delay, 0.0) / duration
    at = np.linspace(0.0, 1.0, len(trajectory))
    return np.stack([np.interp(phase, at, column) for column in trajectory.T], axis=1)


@kernel
def _clears(
    centers: FloatArray,
    radius: FloatArray,
    ticks: NDArray[np.int64],
    offset: int,
    row: FloatArray,
    track: FloatArray,
    clearance: float,
) -> bool:
    """Return whether spheres on one path keep a clearance from one obstacle at all its samples."""
    here = row.copy()
    bound = registry.bound(int(row[0]), row[6:]) + clearance
    last = len(track) - 1
    for t in range(centers.shape[0]):
        tick = min(ticks[t] + offset, last)
        here[1], here[2], here[3] = track[tick, 0], track[tick, 1], track[tick, 2]
        for s in range(centers.shape[1] - 1, -1, -1):
            far = radius[s] + bound
            dx = centers[t, s, 0] - here[1]
            dy = centers[t, s, 1] - here[2]
            dz = centers[t, s, 2] - here[3]
            if far < 0.0 or dx * dx + dy * dy + dz * dz > far * far:
                continue
            distance = point_distance(centers[t, s, 0], centers[t, s, 1], centers[t, s, 2], here)
            if distance < radius[s] + clearance:
                return False
    return True


@kernel
def clears_in_time(
    paths: FloatArray,
    radius: FloatArray,
    ticks: NDArray[np.int64],
    offset: int,
    rows: FloatArray,
    tracks: FloatArray,
    clearance: float,
) -> BoolArray:
    """Return which paths keep a clearance from which moving obstacles, (C, N).

    Args:
        paths: (N, T, S, 3) m, centres of spheres.
        radius: (S,) m.
        ticks: (N, T), when a path's samples are passed.
        offset: ticks by which all of them are later.
        rows: (C, 9) rows of obstacles; their positions are not looked at.
        tracks: (C, K, 3) m, positions at each tick.
        clearance: m; negative, it is how deep they may overlap.
    """
    out = np.zeros((len(rows), len(paths)), np.bool_)
    for c in range(len(rows)):
        for n in range(len(paths)):
            out[c, n] = _clears(paths[n], radius, ticks[n], offset, rows[c], tracks[c], clearance)
    return out
