"""A fast motion along a path within limits of velocity, acceleration and jerk.

The progress along the path is s(τ(t)): a rise s(τ) that begins from rest as τ³ does, and the
squared rate y(τ) = (dτ/dt)², a cubic spline with positive coefficients. For the joints' path p(τ),

    velocity      p' √y
    acceleration  p'' y + p' y' / 2
    jerk          (p''' y + 3/2 p'' y' + p' y'' / 2) √y

so limits of the first two are linear in y, as in TOPP-RA, and that of jerk bounds a linear function
by y^(-1/2), which is convex: its tangent at any y that keeps the limits stays below it. From a slow
motion on, linear programs with these tangents give faster ones, each of which keeps all limits, up
to one that no small change makes faster (convex-concave procedure, Yuille and Rangarajan 2003,
doi:10.1162/08997660360581958). The path itself is never changed.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import numpy as np
from scipy import sparse
from scipy.interpolate import BPoly, BSpline, PPoly
from scipy.optimize import brentq, linprog

from smp_gym.arrays import FloatArray
from smp_planner.library.joint_path import JointPath
from smp_planner.library.motion_limits import MotionLimits, refused_speeds, too_long

__all__ = ["SmoothMotion", "smooth_motion"]

_RAMP = 0.3
"""Share of τ in which the rise s(τ) gains its speed, and loses it; y makes of it what is fast."""

_PIECES = (120, 200)
"""Least and greatest number of pieces of the spline y; between them, three for four samples."""

_CHECKS = 5
"""Checks of the limits in each of its pieces."""

_KNOT_CHECKS = (1e-3, 0.5, 1.0 - 1e-3)
"""Where limits are checked between two samples of the path: its third derivative jumps at each."""

_NEAR = 0.3
"""Share of a limit from which it enters a linear program at once; others enter once they are
exceeded there."""

_CHANGE = (0.2, 5.0)
"""Factors by which one linear program may change a coefficient of y."""

_STEPS = 60
"""Linear programs at most, of each aim."""

_ENOUGH = 1e-3
"""Share of the duration: where a step gains less, the search ends."""

_NODES = 4
"""Parts of each piece of y between which time is known."""


class SmoothMotion:
    """A motion along a path whose acceleration along it is continuous.

    Args:
        rise: s(τ), rad, of τ in [0, 1].
        squared_rate: y(τ), 1/s², positive.
    """

    def __init__(self, rise: PPoly, squared_rate: BSpline) -> None:
        self._rise = rise
        self._squared_rate = squared_rate
        nodes = np.linspace(0.0, 1.0, _NODES * (len(squared_rate.c) - 3) + 1)
        points, weights = _gauss(nodes)
        spent = weights * squared_rate(points) ** -0.5
        times = np.append(0.0, np.cumsum(spent.reshape(len(nodes) - 1, -1).sum(axis=1)))
        y, y1, y2 = (squared_rate(nodes, order) for order in range(3))
        derivatives = np.stack([nodes, np.sqrt(y), 0.5 * y1, 0.5 * y2 * np.sqrt(y)], axis=1)
        # Positions must be as smooth as the derivatives that are computed beside them.
        self._parameter = BPoly.from_derivatives(times, derivatives)
        self.duration = float(times[-1])

    def progress(self, times: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return length, speed, acceleration and jerk along the path; see `Motion`."""
        parameter = np.clip(self._parameter(times), 0.0, 1.0)
        y, y1, y2 = (self._squared_rate(parameter, order) for order in range(3))
        s, s1, s2, s3 = (self._rise(parameter, order) for order in range(4))
        jerk = (s3 * y + 1.5 * s2 * y1 + 0.5 * s1 * y2) * np.sqrt(y)
        return s, s1 * np.sqrt(y), s2 * y + 0.5 * s1 * y1, jerk


def smooth_motion(
    path: JointPath, limits: MotionLimits, lasting: Callable[[float], float] | None = None
) -> SmoothMotion:
    """Return a motion along a path that no small change makes faster.

    Where it begins and ends, it has no acceleration along the path.

    Args:
        path: that is gone through.
        limits: to be kept, with those of jerk, at the points of `_Programs`.
        lasting: returns how long it shall last, s, of the shortest duration; None is the shortest.

    Raises:
        ValueError: no motion has the speeds at the ends, or none lasts so long with them.
    """
    programs = _Programs(path, limits)
    coefficients = programs.slow()
    if not limits.from_rest_to_rest:
        coefficients = programs.with_speeds(coefficients)
    coefficients = programs.fast(coefficients)
    if lasting is not None:
        coefficients = programs.lasting(coefficients, lasting(programs.duration(coefficients)))
    return programs.motion(coefficients)


class _Programs:
    """The linear programs of one path: coefficients (C,) of y that keep the limits, in and out."""

    def __init__(self, path: JointPath, limits: MotionLimits) -> None:
        assert limits.jerk is not None
        self._path, self._limits = path, limits
        least, most = _PIECES
        pieces = int(np.clip(0.75 * len(path.knots), least, most))
        at = np.linspace(0.0, path.length, 1000)
        typical = float(1.0 / np.mean(1.0 / limits.greatest_speed(path, at)))
        self._rise = _rise(path.length, limits.start_speed / typical, limits.end_speed / typical)
        self._knots = np.concatenate([np.zeros(3), np.linspace(0.0, 1.0, pieces + 1), np.ones(3)])
        basis = BSpline(self._knots, np.eye(pieces + 3), 3)
        at = self._checks(pieces)
        zeroth, first, second = (sparse.csr_matrix(basis(at, order)) for order in range(3))
        s, s1, s2, s3 = (self._rise(at, order)[:, None] for order in range(4))
        q1, q2, q3 = (path.spline(s[:, 0], order) for order in (1, 2, 3))
        p1, p2 = q1 * s1, q2 * s1**2 + q1 * s2
        p3 = q3 * s1**3 + 3.0 * q2 * s1 * s2 + q1 * s3
        slowest = s1[:, 0] / limits.greatest_speed(path, s[:, 0])
        self._values = zeroth
        self._velocity = _scaled(slowest**2, zeroth)
        accelerations, jerks = [], []
        for joint, (a, j) in enumerate(zip(limits.acceleration, limits.jerk, strict=True)):
            v1, v2, v3 = p1[:, joint], p2[:, joint], p3[:, joint]
            accelerations.append(_scaled(v2 / a, zeroth) + _scaled(0.5 * v1 / a, first))
            jerks.append(
                _scaled(v3 / j, zeroth)
                + _scaled(1.5 * v2 / j, first)
                + _scaled(0.5 * v1 / j, second)
            )
        self._acceleration = sparse.vstack(accelerations, "csr")
        self._jerk = sparse.vstack(jerks, "csr")
        points, self._weights = _gauss(np.linspace(0.0, 1.0, _NODES * pieces + 1))
        self._quadrature = sparse.csr_matrix(basis(points))
        # The coefficient that is y at an end where the path does not stand still, whose neighbour
        # is equal to it: y' = 0 there. And the y that is asked for.
        self._moving = {
            index: (float(speed / self._rise(tau, 1)) ** 2, neighbour, name)
            for index, neighbour, tau, speed, name in (
                (0, 1, 0.0, limits.start_speed, "start_velocity"),
                (pieces + 2, pieces + 1, 1.0, limits.end_speed, "end_velocity"),
            )
            if speed > 0.0
        }

    def _checks(self, pieces: int) -> FloatArray:
        """Return the τ at which limits are kept: in every piece of y, and between all samples."""
        step = np.diff(self._path.knots)[:, None]
        lengths = (self._path.knots[:-1, None] + step * _KNOT_CHECKS).ravel()
        fine = np.linspace(0.0, 1.0, 100 * pieces + 1)
        even = np.linspace(0.0, 1.0, _CHECKS * pieces + 1)
        return np.unique(np.concatenate([np.interp(lengths, self._rise(fine), fine), even]))

    @cached_property
    def _joints(self) -> int:
        return len(self._limits.velocity)

    def motion(self, coefficients: FloatArray) -> SmoothMotion:
        """Return the motion of coefficients."""
        return SmoothMotion(self._rise, BSpline(self._knots, coefficients, 3))

    def duration(self, coefficients: FloatArray) -> float:
        """Return how long the motion lasts, s."""
        return float(self._weights @ (self._quadrature @ coefficients) ** -0.5)

    def slow(self) -> FloatArray:
        """Return coefficients that keep the limits, all equal, with slower ends than asked for."""
        ones = np.ones(self._values.shape[1])
        velocity, acceleration, jerk = self._shares(ones)
        y = 1.0 / max(velocity.max(), acceleration.max(), jerk.max() ** (2.0 / 3.0))
        return ones * min([y, *(asked for asked, _, _ in self._moving.values())])

    def _shares(self, coefficients: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return what share of the limits is used; of velocity its square."""
        rate = np.tile(np.sqrt(self._values @ coefficients), self._joints)
        return (
            self._velocity @ coefficients,
            np.abs(self._acceleration @ coefficients),
            np.abs(self._jerk @ coefficients) * rate,
        )

    def with_speeds(self, coefficients: FloatArray) -> FloatArray:
        """Return coefficients whose motion has the speeds at the ends that are asked for."""
        reached = {}
        for _ in range(_STEPS):
            before = coefficients
            aim = np.full(len(coefficients), -1e-3 / len(coefficients)) / coefficients
            for index, (asked, _, _) in self._moving.items():
                aim[index] -= 1.0 / asked
            coefficients = self._improved(coefficients, aim)
            reached = {i: coefficients[i] / asked for i, (asked, _, _) in self._moving.items()}
            if min(reached.values()) > 1.0 - 1e-9:
                return coefficients
            gain = max(coefficients[i] / before[i] for i in self._moving)
            if gain < 1.0 + _ENOUGH:
                break
        index = min(reached, key=lambda i: reached[i])
        asked, _, name = self._moving[index]
        end = name == "end_velocity"
        speed = self._limits.end_speed if end else self._limits.start_speed
        raise refused_speeds(self._path, self._limits, name, 0.0, speed * np.sqrt(reached[index]))

    def fast(self, coefficients: FloatArray) -> FloatArray:
        """Return coefficients of a motion that no small change makes faster."""
        duration = self.duration(coefficients)
        for _ in range(_STEPS):
            y = self._quadrature @ coefficients
            aim = -0.5 * self._quadrature.T @ (self._weights * y**-1.5)
            step = self._improved(coefficients, aim, fixed=True) - coefficients
            share = 1.0
            # All between keeps the limits; the duration itself is no linear function.
            while self.duration(coefficients + share * step) > duration and share > 1e-3:
                share *= 0.5
            before, duration = duration, min(duration, self.duration(coefficients + share * step))
            if duration < before:
                coefficients = coefficients + share * step
            if duration > before * (1.0 - _ENOUGH):
                break
        return coefficients

    def lasting(self, coefficients: FloatArray, duration: float) -> FloatArray:
        """Return coefficients of a slower motion with the same speeds at the ends."""
        for _ in range(_STEPS):
            aim = 1.0 / coefficients
            slower = self._improved(coefficients, aim, fixed=True)
            longest = self.duration(slower)
            if longest >= duration:
                step = slower - coefficients

                def excess(share: float, start: FloatArray, step: FloatArray) -> float:
                    return self.duration(start + share * step) - duration

                if excess(0.0, coefficients, step) >= 0.0:
                    return coefficients
                return coefficients + step * brentq(
                    excess, 0.0, 1.0, args=(coefficients, step), xtol=1e-14
                )
            if longest < self.duration(coefficients) * (1.0 + _ENOUGH):
                break
            coefficients = slower
        raise too_long(self.duration(coefficients), duration)

    def _improved(
        self, coefficients: FloatArray, aim: FloatArray, *, fixed: bool = False
    ) -> FloatArray:
        """Return the coefficients that make a linear function least, within the tangents."""
        velocity, acceleration, jerk = self._shares(coefficients)
        inverse = np.tile((self._values @ coefficients) ** -0.5, self._joints)
        values = sparse.vstack([self._values] * self._joints, "csr")
        tangent = _scaled(0.5 * inverse**3, values)
        rows = sparse.vstack(
            [
                self._velocity,
                self._acceleration,
                -self._acceleration,
                self._jerk + tangent,
                tangent - self._jerk,
            ],
            "csr",
        ) @ sparse.diags(coefficients)
        rows = rows.tocsr()
        one = np.ones(len(acceleration))
        bounds = np.concatenate([np.ones(len(velocity)), one, one, 1.5 * inverse, 1.5 * inverse])
        # In units of what a limit is now.
        rows = _scaled(1.0 / bounds, rows)
        used = np.concatenate([velocity, acceleration, acceleration, jerk, jerk])
        within = np.tile(np.array(_CHANGE), (len(coefficients), 1))
        equal = []
        for index, (asked, neighbour, _) in self._moving.items():
            most = asked / coefficients[index]
            within[index] = (1.0, 1.0) if fixed else (_CHANGE[0], min(_CHANGE[1], max(most, 1.0)))
            within[neighbour] = (0.0, np.inf)
            row = np.zeros(len(coefficients))
            row[index], row[neighbour] = coefficients[index], -coefficients[neighbour]
            equal.append(row / coefficients[index])
        working = used > _NEAR
        while True:
            found = linprog(
                aim * coefficients / np.abs(aim * coefficients).max(),
                A_ub=rows[working],
                b_ub=np.ones(working.sum()),
                A_eq=np.array(equal) if equal else None,
                b_eq=np.zeros(len(equal)) if equal else None,
                bounds=within,
                method="highs-ds",
            )
            if found.x is None:
                return coefficients
            exceeded = ~working & (rows @ found.x > 1.0 + 1e-7)
            if not exceeded.any():
                return np.asarray(coefficients * found.x)
            working |= exceeded


def _rise(length: float, start: float, end: float) -> PPoly:
    """Return s(τ), whose speed begins and ends with these shares of that in the middle, at most 1.

    Its second derivative is 0 there.
    """
    r, start, end = _RAMP, min(start, 1.0), min(end, 1.0)
    gaining = (1.0 - start) * np.array([3.0 / r**4, -8.0 / r**3, 6.0 / r**2, 0.0, 0.0])
    losing = (1.0 - end) * np.array([3.0 / r**4, -4.0 / r**3, 0.0, 0.0, 1.0])
    parts = np.stack([gaining, np.zeros(5), losing], axis=1)
    parts[-1] += [start, 1.0, end]
    ends = np.array([0.0, r, 1.0 - r, 1.0])
    rise = PPoly(parts, ends).antiderivative()
    return PPoly(rise.c * (length / rise(1.0)), ends)


def _gauss(nodes: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return points and weights of integrals between nodes, of polynomials up to degree 7."""
    points, weights = np.polynomial.legendre.leggauss(4)
    half = 0.5 * np.diff(nodes)[:, None]
    return (nodes[:-1, None] + half * (1.0 + points)).ravel(), (half * weights).ravel()


def _scaled(factors: FloatArray, rows: sparse.csr_matrix) -> sparse.csr_matrix:
    return (sparse.diags(factors) @ rows).tocsr()
