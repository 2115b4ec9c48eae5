"""Positions of a robot's joints: branches of continuous joints, and limits."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from smp_gym.arrays import FloatArray
from smp_planner.collision.verification import LIMIT_TOLERANCE

if TYPE_CHECKING:
    from smp_planner.library.urdf import Robot

__all__ = ["JointAngles", "refuse_orientations", "unwrapped"]

_TURN = 2.0 * math.pi

_WRAP = 0.1 * _TURN
"""rad by which a step between two samples may differ from a turn and be a wrapped angle."""

_DIGITS = 9
"""Of what is beyond a limit: a value that is beyond by the tolerance passes."""

_UNIT = 1e-2
"""Deviation of an orientation's norms and products from those it has: logs are rounded, to two
digits at least."""

_MATRIX = 9
"""Numbers of a rotation matrix."""


def unwrapped(demonstrations: Sequence[FloatArray], robot: Robot) -> tuple[FloatArray, ...]:
    """Return demonstrations (T_j, n) without jumps of whole turns.

    Continuous joints are unwrapped, and each demonstration is turned to the branch on which it
    begins nearest to the first, if the limits allow.

    Raises:
        ValueError: a joint that is not continuous jumps by about a turn.
    """
    changed: list[FloatArray] = []
    for number, given in enumerate(demonstrations):
        path = given.copy()
        # What slides is as long as it is: no jump of it is a turn.
        for joint in np.flatnonzero(~robot.model.prismatic).tolist():
            endless = robot.continuous[joint]
            there = np.flatnonzero(np.isfinite(path[:, joint]))
            angles = path[there, joint]
            steps = np.abs(np.diff(angles))
            if not endless:
                wraps = np.flatnonzero(np.abs(steps - _TURN) < _WRAP)
                if len(angles) > 2 and len(wraps):
                    raise ValueError(
                        f"demonstrations[{number}] jumps by {steps[wraps[0]]:.3g} rad at sample "
                        f"{there[1 + wraps[0]]} "
                        f"of joint {robot.joints[joint]!r}: unwrap its angles, or declare the "
                        "joint continuous"
                    )
                continue
            angles = np.unwrap(angles)
            first = changed[0][:, joint] if changed else None
            wanted = 0.0 if first is None else first[np.isfinite(first)][0] - angles[0]
            bounds = robot.model.lower[joint], robot.model.upper[joint]
            path[there, joint] = angles + _nearest_turn(wanted, angles.min(), angles.max(), bounds)
        path.setflags(write=False)
        changed.append(path)
    return tuple(changed)


def _nearest_turn(wanted: float, lower: float, upper: float, bounds: tuple[float, float]) -> float:
    """Return the multiple of a turn nearest to `wanted` that keeps [lower, upper] within bounds.

    It is nearest to that if none does.
    """
    least = math.ceil((bounds[0] - LIMIT_TOLERANCE - lower) / _TURN)
    most = math.floor((bounds[1] + LIMIT_TOLERANCE - upper) / _TURN)
    turns = round(wanted / _TURN)
    return _TURN * (min(max(turns, least), most) if least <= most else turns)


@dataclass(frozen=True)
class JointAngles:
    """Limits and branches of a robot's configurations.

    Attributes:
        robot: whose.
        demonstrations: (T_j, n) rad or m; branches are those nearest to them.
    """

    robot: Robot
    demonstrations: Sequence[FloatArray]

    def check_demonstrations(self, continuous: bool = True) -> None:
        """Raise a ValueError if a demonstration leaves the limits.

        Args:
            continuous: whether to look at continuous joints, too.
        """
        model = self.robot.model
        for number, path in enumerate(self.demonstrations):
            beyond = np.round(np.maximum(model.lower - path, path - model.upper), _DIGITS)
            if not continuous:
                beyond[:, np.flatnonzero(self.robot.continuous)] = -np.inf
            if np.nanmax(beyond) > LIMIT_TOLERANCE:
                sample, joint = np.unravel_index(np.nanargmax(beyond), beyond.shape)
                other = "millimetres" if model.prismatic[joint] else "degrees"
                raise ValueError(
                    f"demonstrations[{number}] must keep the limits of joint "
                    f"{self._limits(int(joint))}, got {path[sample, joint]:.6g} at sample {sample}"
                    f": are they in {other}, or the columns in another order?"
                )

    def _limits(self, joint: int) -> str:
        model = self.robot.model
        lower, upper = model.lower[joint], model.upper[joint]
        return f"{self.robot.joints[joint]!r}, [{lower:.6g}, {upper:.6g}] {model.units[joint]}"

    def placed(
        self, name: str, phase: float, lower: FloatArray, upper: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return the corners of a box of configurations on the branch nearest to demonstrations.

        What is beyond a limit by rounding is put at it.

        Args:
            name: what the user calls it.
            phase: at which it is passed.
            lower: (n,) rad or m.
            upper: (n,) rad or m; `lower` for a point.

        Raises:
            ValueError: no part of it is within the limits.
        """
        model = self.robot.model
        lower, upper = lower.copy(), upper.copy()
        for joint in np.flatnonzero(self.robot.continuous).tolist():
            angles = [path[round(phase * (len(path) - 1)), joint] for path in self.demonstrations]
            known = [angle for angle in angles if math.isfinite(angle)]
            middle = (lower[joint] + upper[joint]) / 2.0
            if known:
                bounds = float(model.lower[joint]), float(model.upper[joint])
                turn = _nearest_turn(float(np.mean(known)) - middle, middle, middle, bounds)
                lower[joint] += turn
                upper[joint] += turn
        beyond = np.round(np.maximum(model.lower - upper, lower - model.upper), _DIGITS)
        worst = int(beyond.argmax())
        if beyond[worst] > LIMIT_TOLERANCE:
            value = upper[worst] if upper[worst] < model.lower[worst] else lower[worst]
            raise ValueError(
                f"{name} must keep the limits of joint {self._limits(worst)}, got {value:.9g}"
            )
        allowed = model.lower, model.upper
        return np.clip(lower, *allowed), np.clip(upper, *allowed)


def refuse_orientations(demonstrations: Sequence[FloatArray]) -> None:
    """Raise a ValueError if coordinates after each other are quaternions or rotation matrices.

    That is, if four always have norm 1, or nine the columns of a rotation. Each would be learned on
    its own, and what comes out would be no orientation.
    """
    samples = np.concatenate(demonstrations)
    samples = samples[np.isfinite(samples).all(axis=1)]
    if not len(samples):
        return
    found = None
    for first in range(samples.shape[1] - _MATRIX + 1):
        matrices = samples[:, first : first + _MATRIX].reshape(-1, 3, 3)
        products = matrices @ matrices.swapaxes(1, 2)
        if np.abs(products - np.eye(3)).max() <= 2.0 * _UNIT:
            found = first, _MATRIX, "are orthonormal in all samples, as rotation matrices"
            break
    for first in range(samples.shape[1] - 3) if found is None else ():
        norms = np.linalg.norm(samples[:, first : first + 4], axis=1)
        if np.abs(norms - 1.0).max() <= _UNIT:
            found = first, 4, "have norm 1 in all samples, as quaternions"
            break
    if found is not None:
        first, count, what = found
        raise ValueError(
            f"coordinates {first} to {first + count - 1} of the demonstrations {what}: a path of "
            "plain coordinates does not keep them orientations; leave them out, or give "
            "configurations of a robot"
        )
