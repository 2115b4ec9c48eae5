"""A robot's trajectory in time: as fast along a path as its limits allow.

A plan says where the joints go, not when. The path is kept exactly; limits of velocity and
acceleration alone are those of `fastest_motion`, with jerk those of `smooth_motion`.
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from smp_gym.arrays import FloatArray, checked_array, shown
from smp_gym.atomic_files import write_text
from smp_planner.library.fastest_motion import fastest_motion
from smp_planner.library.joint_path import JointPath
from smp_planner.library.motion_limits import Motion, MotionLimits
from smp_planner.library.smooth_motion import smooth_motion
from smp_planner.library.timing_settings import TimingSettings

__all__ = ["MOST_SAMPLES", "Event", "TimedTrajectory", "timed"]

_LEAST_CHECKS = 20_000
"""Times at which limits are checked at least; as many as there are samples, if these are more."""

MOST_SAMPLES = 1_000_000
"""Of a motion: almost three hours at 100 Hz, and some 200 MB for seven joints."""

_ROUNDING = 1e-9
"""Share of a duration by which it may be missed."""

_ATTEMPTS = 6
"""How often the motion is worked out with smaller limits, where a limit was exceeded between the
points at which it is kept."""


@dataclass(frozen=True)
class Event:
    """A signal that switches.

    Attributes:
        time: s, from the start of the motion.
        name: of the signal.
        value: from then on.
    """

    time: float
    name: str
    value: float


@dataclass(frozen=True, eq=False)
class TimedTrajectory:
    """A trajectory of n joints at N equal steps of time.

    Made by `timed`, or `Robot.timed`.

    Attributes:
        joints: (n) names of the joints.
        times: (N,) s, from 0.
        positions: (N, n) rad, or m of a prismatic joint.
        velocities: (N, n) rad/s or m/s.
        accelerations: (N, n) rad/s² or m/s².
        phases: (N,) of the path.
        signals: (N,) by name.
        events: where signals switch after the start, in the order of time, exact between samples.
    """

    joints: tuple[str, ...]
    times: FloatArray
    positions: FloatArray
    velocities: FloatArray
    accelerations: FloatArray
    phases: FloatArray
    signals: Mapping[str, FloatArray] = field(default_factory=dict)
    events: tuple[Event, ...] = ()

    def __repr__(self) -> str:
        """Return a short description, without the arrays."""
        signals = f", {', '.join(self.signals)}" if self.signals else ""
        return (
            f"TimedTrajectory({len(self.joints)} joints{signals}, {self.duration:.3f} s, "
            f"{len(self.times)} samples)"
        )

    @property
    def duration(self) -> float:
        """Time from start to end, s."""
        return float(self.times[-1])

    def joint_trajectory(self) -> dict[str, Any]:
        """Return the fields of a ROS message `trajectory_msgs/JointTrajectory`; needs no ROS.

        It holds joints only, no signals.
        """
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
                ``acceleration:`` followed by its name, then ``signal:`` followed by that of each
                signal; ``.json``: `joint_trajectory`, and where there are signals beside it
                ``signals``, their samples by name, and ``events``, with ``time``, ``name`` and
                ``value``.

        Raises:
            ValueError: another suffix.
        """
        path = Path(path)
        if path.suffix == ".json":
            content = self.joint_trajectory()
            if self.signals:
                content["signals"] = {name: each.tolist() for name, each in self.signals.items()}
                content["events"] = [vars(event) for event in self.events]
            write_text(path, json.dumps(content, indent=1) + "\n")
        elif path.suffix == ".csv":
            write_text(path, self._csv())
        else:
            raise ValueError(f"path must end in .csv or .json, got {shown(str(path))}")

    def _csv(self) -> str:
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        kinds = ("", "velocity:", "acceleration:")
        names = [kind + name for kind in kinds for name in self.joints]
        writer.writerow(["time", *names, *(f"signal:{name}" for name in self.signals)])
        columns = [self.times[:, None], self.positions, self.velocities, self.accelerations]
        columns += [signal[:, None] for signal in self.signals.values()]
        # Adding zero turns -0 into 0.
        writer.writerows((np.concatenate(columns, axis=1).round(9) + 0.0).tolist())
        return text.getvalue()


def timed(
    joints: tuple[str, ...],
    velocity: FloatArray,
    path: FloatArray,
    acceleration: Any,
    settings: TimingSettings,
    units: Sequence[str] = ("rad",),
) -> TimedTrajectory:
    """Return the fastest motion along a path.

    The path between two samples is that of a cubic spline, and is kept exactly. Limits are kept
    between the samples of the motion, too. With a limit of jerk the motion is one that no small
    change makes faster (`smooth_motion`).

    Args:
        joints: (n) their names.
        velocity: (n,) rad/s or m/s, their limits.
        path: (T, n) rad or m, T ≥ 2, such as `Plan.best`. Where samples lie much closer than
            elsewhere, some are left out.
        acceleration: rad/s² or m/s², limit of all joints or of each (n,); of each, if both units
            occur.
        settings: all else.
        units: (n) of the joints, "rad" or "m"; "rad" for all by default.

    Raises:
        ModuleNotFoundError: the package `toppra` is not installed; with `jerk` it is not needed.
        ValueError: an argument is out of range, all samples are the same, a velocity at an end is
            not along the path or beyond what the limits allow, `duration` is too short, or too long
            for them, or there would be `MOST_SAMPLES` or more; the message says what is allowed.
    """
    curve = JointPath(path, len(joints), units)
    limits = MotionLimits(
        velocity,
        _limits("acceleration", acceleration, len(joints), units),
        None if settings.jerk is None else _limits("jerk", settings.jerk, len(joints), units),
        curve.speed("start_velocity", settings.start_velocity, end=False),
        curve.speed("end_velocity", settings.end_velocity, end=True),
        settings.pace,
    ).slower(settings.speed)
    motion, whole = _within_limits(curve, limits, settings)
    longer = whole / motion.duration
    times = np.linspace(0.0, longer * motion.duration, _samples(whole, settings.rate))
    progress = motion.progress(np.minimum(times / longer, motion.duration))
    positions, velocities, accelerations, _ = curve.moved(*progress)
    phases = curve.phase(progress[0])
    return TimedTrajectory(
        joints,
        times,
        positions,
        velocities / longer,
        accelerations / longer**2,
        phases,
        {name: signal(phases) for name, signal in settings.signals.items()},
        _events(curve, motion, longer, settings),
    )


def _limits(name: str, given: Any, dimension: int, units: Sequence[str]) -> FloatArray:
    if np.ndim(given) == 0 and len(set(units)) > 1:
        raise ValueError(
            f"{name} must have one entry for each joint, in the units {', '.join(units)} by the "
            f"second, got {shown(given)}"
        )
    limits = checked_array(name, given, (dimension,) if np.ndim(given) else ())
    if not (limits > 0.0).all():
        raise ValueError(f"{name} must be above 0, got {shown(given)}")
    return np.array(np.broadcast_to(limits, dimension))


def _samples(duration: float, rate: float) -> int:
    """Return how many samples a motion has, both ends among them."""
    if not duration * rate < MOST_SAMPLES:
        raise ValueError(
            f"the motion must have fewer than {MOST_SAMPLES} samples, but takes {duration:.6g} s "
            f"at rate={rate:.6g}: choose a lower rate, or a shorter duration or pace (s) if one "
            "was given, or greater limits"
        )
    return int(np.ceil(duration * rate * (1.0 - _ROUNDING))) + 1


def _whole(takes: float, settings: TimingSettings) -> float:
    """Return how long a motion lasts that can be done in a time, s."""
    if settings.duration is None:
        return (_samples(takes, settings.rate) - 1) / settings.rate
    if settings.duration < takes * (1.0 - _ROUNDING):
        raise ValueError(
            f"duration must be at least {takes:.3f} s for this path, got {settings.duration}"
        )
    return max(settings.duration, takes)


def _within_limits(
    path: JointPath, limits: MotionLimits, settings: TimingSettings
) -> tuple[Motion, float]:
    """Return a motion, and the duration in which it keeps the limits between all samples, too.

    From rest to rest it may be the longer of the two, for the motion can be stretched. Otherwise
    that would change its velocities at the ends.
    """
    find: Callable[..., Motion] = fastest_motion if limits.jerk is None else smooth_motion
    resting = limits.from_rest_to_rest
    lasting = None if resting else lambda takes: _whole(takes, settings)
    share = velocity_share = 1.0
    for _ in range(_ATTEMPTS):
        motion = find(path, limits.slower(share, velocity_share), lasting)
        count = max(_LEAST_CHECKS, _samples(motion.duration, settings.rate))
        velocity, other = limits.exceeded(path, motion, np.linspace(0.0, motion.duration, count))
        exceeded = max(velocity, other)
        if exceeded <= (1.0 if resting else 1.0 + 1e-9):
            return motion, _whole(motion.duration, settings)
        if resting and limits.jerk is not None:
            return motion, _whole(motion.duration * exceeded * (1.0 + 1e-6), settings)
        # A velocity at an end may be near its limit, so this one is lowered no further than needed.
        velocity_share /= max(velocity, 1.0) * (1.0 + 1e-9)
        if other > 1.0:
            share /= other * (1.0 + (1e-6 if resting else 1e-4 if limits.jerk is None else 1e-3))
    raise ValueError("path has no motion within the limits: it bends too sharply")


def _events(
    path: JointPath, motion: Motion, longer: float, settings: TimingSettings
) -> tuple[Event, ...]:
    """Return where signals switch, in the order of time."""
    count = max(_LEAST_CHECKS, _samples(motion.duration, settings.rate))
    times = np.linspace(0.0, motion.duration, count)
    phases = path.phase(motion.progress(times)[0])
    events = []
    for name, signal in settings.signals.items():
        if signal.switches:
            reached = longer * np.interp(signal.phases[1:], phases, times)
            for time, value in zip(reached.tolist(), signal.values[1:].tolist(), strict=True):
                events.append(Event(time, name, value))
    return tuple(sorted(events, key=lambda event: event.time))
