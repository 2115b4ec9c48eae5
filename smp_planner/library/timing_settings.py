"""Settings of the motion along a path: how fast, at which rate, and what goes with it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from smp_gym.arrays import checked_number, shown
from smp_planner.library.signals import Signal

__all__ = ["TimingSettings"]


@dataclass(frozen=True, eq=False, kw_only=True)
class TimingSettings:
    """How a path is gone through in time.

    Attributes:
        jerk: rad/s³ or m/s³, limit of all joints or of each (n,); of each, if some joints are
            revolute and others prismatic. None leaves it unlimited, and the
            acceleration jumps. With it, the motion begins and ends with no acceleration along the
            path.
        rate: samples in a second. Where `duration` is no whole number of them, they stand a little
            closer, up to the end.
        speed: share of the limits of velocity, above 0, at most 1; accelerations are limited to
            its square and jerks to its cube, so that the motion is the same but slower. Velocities
            at the ends stay as they are.
        duration: s, of the whole motion; by default the shortest that is a whole number of samples.
        start_velocity: rad/s or m/s, where the path begins: of the joints (n,), along the path, or
            its norm, if all joints are revolute or all prismatic. What is across the path, 2 % at
            most, is dropped.
        end_velocity: where it ends, likewise.
        pace: s, such as the mean of `SMP.durations`: the motion is nowhere faster than if the
            samples of the path stood at equal steps of time in this duration. It is slower where
            limits bind, and where it begins and ends; so it lasts longer.
        signals: by name, what is sampled with the motion, such as `Plan.signals`.

    Raises:
        ValueError: a number is out of range, or signals are none.
    """

    jerk: Any = None
    rate: float = 100.0
    speed: float = 1.0
    duration: float | None = None
    start_velocity: Any = 0.0
    end_velocity: Any = 0.0
    pace: float | None = None
    signals: Mapping[str, Signal] = field(default_factory=dict)

    def __post_init__(self) -> None:
        checked_number("rate", self.rate, above=0.0)
        checked_number("speed", self.speed, above=0.0, most=1.0)
        for name in ("duration", "pace"):
            if getattr(self, name) is not None:
                checked_number(name, getattr(self, name), above=0.0)
        signals = self.signals
        if not isinstance(signals, Mapping) or not all(
            isinstance(signal, Signal) for signal in signals.values()
        ):
            raise ValueError(f"signals must map names to Signals, got {shown(signals)}")
