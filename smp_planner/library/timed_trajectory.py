"""A robot's trajectory in time: as fast along a path as velocities and accelerations allow.

A plan says where the joints go, not when. TOPP-RA (Pham and Pham 2018,
doi:10.1109/TRO.2018.2819195; the package `toppra`) finds the fastest motion along a path under
limits of velocity and acceleration, from rest to rest.
"""

from __future__ import annotations

import csv
import io
import json
import logging
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from smp_gym.arrays import FloatArray, checked_array, checked_number, shown
from smp_gym.atomic_files import write_text
from smp_gym.optional_packages import require

__all__ = ["TimedTrajectory", "timed"]

_GRID = 4
"""Points of the grid of phase, at which limits are kept, in each interval between two samples."""

_DENSE = 10
"""Times between two samples in time at which limits are checked, too."""

_ATTEMPTS = 6
"""How often the motion is worked out with smaller limits, where a limit was exceeded between points
of the grid."""

_LEAST_STEP = 0.25
"""Least distance between two samples of a path that are gone through, as a share of the mean one:
where a movement begins and ends, samples lie so close that their rounding bends the path."""


@dataclass(frozen=True, eq=False)
class TimedTrajectory:
    """A trajectory of n joints at N equal steps of time, from rest to rest.

    Made by `timed`, or `Robot.timed`.

    Attributes:
        joints: (n) names of the joints.
        times: (N,) s, from 0.
        positions: (N, n) rad.
        velocities: (N, n) rad/s.
        accelerations: (N, n) rad/s².
    """

    joints: tuple[str, ...]
    times: FloatArray
    positions: FloatArray
    velocities: FloatArray
    accelerations: FloatArray

    def __repr__(self) -> str:
        """Return a short description, without the arrays."""
        return (
            f"TimedTrajectory({len(self.joints)} joints, {self.duration:.3f} s, "
            f"{len(self.times)} samples)"
        )

    @property
    def duration(self) -> float:
        """Time from start to end, s."""
        return float(self.times[-1])

    def joint_trajectory(self) -> dict[str, Any]:
        """Return the fields of a ROS message `trajectory_msgs/JointTrajectory`; needs no ROS."""
        points = []
        rows = zip(self.times, self.positions, self.velocities, self.accelerations, strict=True)
        for time, position, velocity, acceleration in rows:
            nanoseconds = round(float(time) * 1e9)
            points.append(
                {
                    "positions": position.tolist(),
                    "velocities": velocity.tolist(),
                    "accelerations": acceleration.tolist(),
                    "effort": [],
                    "time_from_start": {
                        "sec": nanoseconds // 10**9,
                        "nanosec": nanoseconds % 10**9,
                    },
                }
            )
        return {"joint_names": list(self.joints), "points": points}

    def save(self, path: str | Path) -> None:
        """Write the trajectory to a file.

        Args:
            path: ``.csv``: the columns ``time`` and, by joint, its name, ``velocity:`` and
                ``acceleration:`` followed by its name; ``.json``: `joint_trajectory`.

        Raises:
            ValueError: another suffix.
        """
        path = Path(path)
        if path.suffix == ".json":
            write_text(path, json.dumps(self.joint_trajectory(), indent=1) + "\n")
        elif path.suffix == ".csv":
            write_text(path, self._csv())
        else:
            raise ValueError(f"path must end in .csv or .json, got {shown(str(path))}")

    def _csv(self) -> str:
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        kinds = ("", "velocity:", "acceleration:")
        writer.writerow(["time", *(kind + name for kind in kinds for name in self.joints)])
        columns = (self.times[:, None], self.positions, self.velocities, self.accelerations)
        # Adding zero turns -0 into 0.
        writer.writerows((np.concatenate(columns, axis=1).round(9) + 0.0).tolist())
        return text.getvalue()


def timed(
    joints: tuple[str, ...],
    velocity: FloatArray,
    path: FloatArray,
    acceleration: Any,
    *,
    rate: float = 100.0,
    speed: float = 1.0,
    duration: float | None = None,
) -> TimedTrajectory:
    """Return the fastest motion along a path, from rest to rest.

    The path between two samples is that of a cubic spline.

    Args:
        joints: (n) their names.
        velocity: (n,) rad/s, their limits.
        path: (T, n) rad, T ≥ 2, such as `Plan.best`. Where samples lie much closer than elsewhere,
            some are left out.
        acceleration: rad/s², limit of all joints or of each (n,).
        rate: samples in a second. Where `duration` is no whole number of them, they stand a little
            closer, up to the end.
        speed: share of the limits of velocity, above 0, at most 1; accelerations are limited to
            its square, so that the motion is the same but slower.
        duration: s, of the whole motion; by default the shortest that is a whole number of samples.

    Raises:
        ImportError: the package `toppra` is not installed.
        ValueError: an argument is out of range, all samples are the same, or `duration` is too
            short; the message says how long it takes.
    """
    dimension = len(joints)
    path = checked_array("path", path, (None, dimension))
    limits = np.asarray(acceleration)
    limits = checked_array("acceleration", limits, (dimension,) if limits.ndim else ())
    if not (limits > 0.0).all():
        raise ValueError(f"acceleration must be above 0, got {shown(acceleration)}")
    rate = checked_number("rate", rate, above=0.0)
    speed = checked_number("speed", speed, above=0.0, most=1.0)
    if len(path) < 2 or not (path != path[0]).any():
        raise ValueError("path must have at least two samples that differ")

    limits = speed**2 * np.broadcast_to(limits, dimension)
    motion = _fastest(path, speed * velocity, limits, rate)
    takes = float(motion.duration)
    if duration is not None:
        duration = checked_number("duration", duration, above=0.0)
        if duration < takes * (1.0 - 1e-9):
            raise ValueError(
                f"duration must be at least {takes:.3f} s for this path, got {duration}"
            )
    if duration is None:
        duration = (_samples(takes, rate) - 1) / rate
    longer = max(duration / takes, 1.0)
    times = np.linspace(0.0, longer * takes, _samples(longer * takes, rate))
    at = np.minimum(times / longer, takes)
    return TimedTrajectory(
        joints,
        times,
        motion(at),
        motion(at, 1) / longer,
        motion(at, 2) / longer**2,
    )


def _samples(duration: float, rate: float) -> int:
    return int(np.ceil(duration * rate - 1e-9)) + 1


def _spaced(path: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return samples of a path (K, n) that are not too close, both ends among them.

    And the length of the path up to each of them, (K,) rad.
    """
    length = np.append(0.0, np.cumsum(np.sqrt((np.diff(path, axis=0) ** 2).sum(axis=1))))
    least = _LEAST_STEP * length[-1] / (len(path) - 1)
    kept = [0]
    for sample in range(1, len(path)):
        if length[sample] - length[kept[-1]] >= least:
            kept.append(sample)
    if length[-1] - length[kept[-1]] > 0.0:
        # In place of one that is too close to it.
        kept[1 if len(kept) == 1 else -1 :] = [len(path) - 1]
    return path[kept], length[kept]


def _fastest(path: FloatArray, velocity: FloatArray, acceleration: FloatArray, rate: float) -> Any:
    """Return a function of time (s) and order of derivative; ``.duration`` is in s."""
    require("timing", "timing a trajectory")
    import toppra
    from toppra.algorithm import TOPPRA
    from toppra.constraint import (
        DiscretizationType,
        JointAccelerationConstraint,
        JointVelocityConstraint,
    )

    logging.getLogger("toppra").setLevel(logging.ERROR)
    path, length = _spaced(path)
    # Along its length a path nowhere stands still, as it may along the phase.
    spline = toppra.SplineInterpolator(length, path)
    samples = np.arange(len(path))
    grid = np.interp(np.linspace(0.0, samples[-1], _GRID * samples[-1] + 1), samples, length)
    share = 1.0
    for _ in range(_ATTEMPTS):
        constraints = [
            JointVelocityConstraint(share * velocity),
            JointAccelerationConstraint(
                share**2 * acceleration,
                discretization_scheme=DiscretizationType.Interpolation,
            ),
        ]
        instance = TOPPRA(
            constraints, spline, gridpoints=grid, parametrizer="ParametrizeConstAccel"
        )
        motion = instance.compute_trajectory(0.0, 0.0)
        if motion is None:
            break
        dense = np.linspace(0.0, motion.duration, _DENSE * _samples(motion.duration, rate))
        exceeded = max(
            (np.abs(motion(dense, 1)) / velocity).max(),
            np.sqrt((np.abs(motion(dense, 2)) / acceleration).max()),
        )
        if exceeded <= 1.0:
            return motion
        share /= exceeded * (1.0 + 1e-6)
    raise ValueError("path has no motion within the limits: it bends too sharply")
