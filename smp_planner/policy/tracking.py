"""Trajectory tracking: actions from a trajectory, and the gripper's events along it.

The environments integrate an action into a joint reference that the motors follow, so a
trajectory is executed by commanding, at each control step, the difference between where the
reference should be and where it is. Nothing accumulates: a step that was cut off at the limits is
caught up by the next.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smp_gym.arrays import FloatArray
from smp_gym.control import reference_action
from smp_gym.observation import CONTROL_PERIOD, state_field

__all__ = ["CLOSING_STEPS", "SETTLING_STEPS", "GripperEvent", "Track", "gripper_event"]

SETTLING_STEPS = 4
"""Control steps between arriving and opening the hand, so that the object drops from rest."""

CLOSING_STEPS = 20
"""Control steps for which the arm stands still while the hand closes."""


@dataclass(frozen=True)
class GripperEvent:
    """The one change of the gripper in a demonstration.

    Attributes:
        phase: in [0, 1], when it happens.
        command: gripper action from then on: -1 opens, +1 closes.
    """

    phase: float
    command: float


def gripper_event(gripper: FloatArray) -> GripperEvent | None:
    """Learn from demonstrations when the gripper changes, and to what.

    Args:
        gripper: (N, T) commanded gripper reference of N demonstrations, 0 open to 1 closed.

    Returns:
        The event at the mean of the demonstrated phases, or None if no demonstration has one.
    """
    closed = np.asarray(gripper) >= 0.5
    changes = closed[:, 1:] != closed[:, :-1]
    having = changes.any(1)
    if not having.any():
        return None
    first = changes[having].argmax(1) + 1
    after = closed[having, -1].mean() >= 0.5
    return GripperEvent(float(first.mean() / (closed.shape[1] - 1)), 1.0 if after else -1.0)


@dataclass(frozen=True)
class Track:
    """A trajectory with its timing in an episode.

    Attributes:
        trajectory: (T, 6) rad, at equal steps of phase.
        duration: s, in which it is executed.
        event: of the gripper, if there is one.
        first_step: environment step at which execution began.
    """

    trajectory: FloatArray
    duration: float
    event: GripperEvent | None
    first_step: int = 0

    def reference(self, time: float) -> FloatArray:
        """Return the reference (6,) rad at a time (s since execution began)."""
        position = np.clip(time / self.duration, 0.0, 1.0) * (len(self.trajectory) - 1)
        before = min(int(position), len(self.trajectory) - 2)
        share = position - before
        return np.asarray(
            (1 - share) * self.trajectory[before] + share * self.trajectory[before + 1]
        )

    def phase(self, step: int) -> float:
        """Return the phase in [0, 1] that is due after so many environment steps of the episode."""
        return float(np.clip(self._time(step - self.first_step) / self.duration, 0.0, 1.0))

    def action(self, step: int, reference: FloatArray) -> NDArray[np.float32]:
        """Return the action (7,) of one environment step.

        Args:
            step: environment steps since the episode began.
            reference: (6,) rad, the reference that the environment holds now.
        """
        elapsed = step - self.first_step
        target = self.reference(self._time(elapsed + 1))
        return reference_action(target, reference, self._gripper(elapsed))

    def predict(
        self,
        observation: Any,
        state: int | None = None,
        episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], int]:
        """Act as a policy of `smp_gym.rollout.rollout` does: return the action (7,) and a state.

        Args:
            observation: of an environment that takes joint velocities, as dict.
            state: what the last call returned: environment steps since the episode began.
            episode_start: accepted for the interface, unused.
            deterministic: accepted for the interface, unused.
        """
        step = self.first_step if state is None else state
        return self.action(step, state_field(observation, "reference")), step + 1

    def _time(self, elapsed: int) -> float:
        """Return the time of the trajectory, s, that is due after so many control steps."""
        time = elapsed * CONTROL_PERIOD
        if self.event is None or self.event.command < 0.0 or self.event.phase >= 1.0:
            return time
        begin = self.event.phase * self.duration
        held = np.ceil(begin / CONTROL_PERIOD) + CLOSING_STEPS
        return min(time, begin) if elapsed <= held else time - CLOSING_STEPS * CONTROL_PERIOD

    def _gripper(self, elapsed: int) -> float:
        if self.event is None:
            return 0.0
        due = self.event.phase * self.duration / CONTROL_PERIOD
        if self.event.phase >= 1.0:
            due += SETTLING_STEPS
        return self.event.command if elapsed >= due else -self.event.command
