"""Signals: what demonstrations recorded beside their coordinates, as functions of phase.

The opening of a gripper, a valve, a light: they are no part of what is planned, and go with it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from smp_gym.arrays import FloatArray

__all__ = ["Recorded", "Signal"]

_PHASES = 201
"""Phases at which the mean of demonstrations is kept."""


@dataclass(frozen=True, eq=False)
class Signal:
    """A number as a function of phase.

    Attributes:
        phases: (M,) ascending, the first one 0.
        values: (M,) at them.
        switches: whether each value holds up to the next phase; if not, it changes evenly.
    """

    phases: FloatArray
    values: FloatArray
    switches: bool

    def __call__(self, phase: FloatArray) -> FloatArray:
        """Return the values (N,) at phases (N,) in [0, 1]."""
        if self.switches:
            at = np.searchsorted(self.phases, phase, "right") - 1
            return np.asarray(self.values[np.maximum(at, 0)])
        return np.asarray(np.interp(phase, self.phases, self.values))

    def __repr__(self) -> str:
        """Return a short description, without the arrays."""
        if self.switches:
            pairs = zip(self.phases, self.values, strict=True)
            return f"Signal({', '.join(f'{value:g} from {phase:.3f}' for phase, value in pairs)})"
        return f"Signal({self.values.min():g} to {self.values.max():g})"


@dataclass(frozen=True, eq=False)
class Recorded:
    """What N demonstrations recorded beside their coordinates.

    Attributes:
        durations: (N,) in the unit of the times, s if those are; None where there were no times.
        phases: N arrays (T_j,) of the samples, from 0 to 1.
        values: by the name of the signal, N arrays (T_j,).
    """

    durations: FloatArray | None = None
    phases: Sequence[FloatArray] = ()
    values: Mapping[str, Sequence[FloatArray]] = field(default_factory=dict)

    def signals(self) -> dict[str, Signal]:
        """Return the demonstrations' signals.

        One that has two values in all demonstrations together switches at the mean of the phases at
        which it does in them, the first samples with the new value; another is their mean.

        Raises:
            ValueError: one switches in some demonstrations otherwise than in others.
        """
        return {name: _signal(name, self.phases, values) for name, values in self.values.items()}


def _signal(name: str, phases: Sequence[FloatArray], values: Sequence[FloatArray]) -> Signal:
    if len(np.unique(np.concatenate(values))) != 2:
        even = np.linspace(0.0, 1.0, _PHASES)
        each = [np.interp(even, p, v) for p, v in zip(phases, values, strict=True)]
        return Signal(even, np.mean(each, axis=0), False)
    starts = [np.flatnonzero(np.diff(v, prepend=np.nan) != 0.0) for v in values]
    orders = [v[at].tolist() for v, at in zip(values, starts, strict=True)]
    for index, order in enumerate(orders):
        if order != orders[0]:
            raise ValueError(
                f"signal {name!r} must switch alike in all demonstrations, but its values are "
                f"{orders[0]} in demonstrations[0] and {order} in demonstrations[{index}]"
            )
    each = [p[at] for p, at in zip(phases, starts, strict=True)]
    return Signal(np.mean(each, axis=0), np.array(orders[0]), True)
