"""Metrics by which sets of trajectories are compared: similarity, length, smoothness, success.

The six of Table II, and smoothness. The paper names them and gives no formula; what is computed
here stands in the docstrings. A set is an array (N, T, d) of N trajectories, each of T samples at
equal steps of time. Lengths are in the unit of the arrays, which is metres for the points of an end
effector.

Distances between finite sets are not zero for two draws of one distribution. What they are then is
the noise floor: the metrics of a fresh draw of the prior, as many as there are particles, against
the reference, itself a draw of the prior.
"""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import ot
from numpy.typing import ArrayLike
from scipy.interpolate import make_interp_spline
from scipy.spatial.distance import cdist, pdist

from smp_gym.arrays import FloatArray
from smp_gym.compiling import kernel

__all__ = [
    "COMPARED_SAMPLES",
    "Metrics",
    "SuccessRates",
    "compare",
    "energy_distance",
    "frechet",
    "frechet_distances",
    "log_dimensionless_jerk",
    "mmd",
    "path_lengths",
    "resample",
    "rms_distances",
    "success_rates",
    "wasserstein",
]

COMPARED_SAMPLES = 50
"""Samples of each trajectory over which `compare` measures similarity."""

_TRANSPORT_ITERATIONS = 10_000_000
_JERK_DEGREE = 5


@dataclass(frozen=True)
class Metrics:
    """A set of trajectories against a reference, from `compare`.

    Attributes:
        mmd: `mmd`, in [0, √2], no unit.
        wasserstein: `wasserstein`, m.
        frechet: `frechet`, m.
        mean_length: mean of `path_lengths`, m.
        min_length: least of `path_lengths`, m.
        smoothness: mean of `log_dimensionless_jerk`, no unit; greater is smoother.
    """

    mmd: float
    wasserstein: float
    frechet: float
    mean_length: float
    min_length: float
    smoothness: float


@dataclass(frozen=True)
class SuccessRates:
    """Success rates of trajectories and of their waypoints; see `success_rates`.

    Attributes:
        trajectories: share of trajectories that reach the goal and are free at all waypoints.
        waypoints: share of collision-free waypoints of all trajectories together.
    """

    trajectories: float
    waypoints: float


def compare(particles: ArrayLike, reference: ArrayLike) -> Metrics:
    """Compare a set of trajectories with a reference.

    Similarity is measured after `resample`; length and smoothness on the samples as given, so give
    sets that are compared with each other at the same T. An unadapted primitive is as similar to
    itself as can be: compare successful trajectories only, and beside the noise floor.

    Args:
        particles: (N, T, d) m, N >= 1, T >= 6.
        reference: (M, U, d) m, M >= 2, U >= 2; such as draws of the unadapted primitive.

    Raises:
        ValueError: an array has another shape or is not finite, a particle stands still, or most of
            the reference is one and the same trajectory.
    """
    given = _checked("particles", particles, _JERK_DEGREE + 1)
    draws = _checked("reference", reference)
    _check_alike("reference", draws, "particles", given, same_samples=False)
    lengths = path_lengths(given)
    a, b = resample(given), resample(draws)
    return Metrics(
        mmd=mmd(a, b, _median_distance("reference", b)),
        wasserstein=wasserstein(a, b),
        frechet=frechet(a, b),
        mean_length=float(lengths.mean()),
        min_length=float(lengths.min()),
        smoothness=float(log_dimensionless_jerk(given).mean()),
    )


def mmd(a: ArrayLike, b: ArrayLike, bandwidth: float | None = None) -> float:
    """Return the maximum mean discrepancy of two sets under an RBF kernel (Gretton et al. 2012).

    The kernel is exp(-r² / 2h²), r the distance of `rms_distances`, so that its bandwidth does not
    change its meaning with T. The estimator is the biased one, with all pairs in each mean (Eq. (5)
    there), and its root is returned: unlike the unbiased one it is never negative, zero for equal
    sets, and a distance. Its bias falls with the size of the sets, so compare sets of equal size.

    Args:
        a: (N, T, d).
        b: (M, T, d), the reference.
        bandwidth: h, in the unit of the sets; by default the median distance of two trajectories
            of the reference, which then needs at least two.

    Returns:
        In [0, √2], no unit.

    Raises:
        ValueError: shapes do not match, values are not finite, the bandwidth is not positive, or
            more than half of the pairs inside the reference coincide, so that it has no median.
    """
    first, second = _checked_pair(a, b)
    if bandwidth is None:
        bandwidth = _median_distance("b", second)
    elif not (math.isfinite(bandwidth) and bandwidth > 0.0):
        raise ValueError(f"bandwidth must be positive and finite, got {bandwidth}")
    of_a, of_b, between = (
        float(np.exp(-0.5 * (_rms(x, y) / bandwidth) ** 2).mean())
        for x, y in ((first, first), (second, second), (first, second))
    )
    return math.sqrt(max(of_a + of_b - 2.0 * between, 0.0))


def wasserstein(a: ArrayLike, b: ArrayLike) -> float:
    """Return the Wasserstein-1 distance of two sets, by optimal transport.

    The cost of moving one trajectory to another is the distance of `rms_distances`; all
    trajectories of a set weigh the same. Solved exactly, by the network simplex of POT
    (Flamary et al. 2021).

    Args:
        a: (N, T, d).
        b: (M, T, d).

    Returns:
        In the unit of the sets.

    Raises:
        ValueError: shapes do not match, or values are not finite.
        RuntimeError: the transport problem was not solved.
    """
    cost, log = ot.emd2(
        [], [], _rms(*_checked_pair(a, b)), numItermax=_TRANSPORT_ITERATIONS, log=True
    )
    if log["warning"] is not None:
        raise RuntimeError(f"optimal transport was not solved: {log['warning']}")
    return float(cost)


def frechet(a: ArrayLike, b: ArrayLike) -> float:
    """Return the mean of minima of the discrete Fréchet distance between two sets, symmetric.

    Each trajectory of either set has a nearest one in the other. The result is half the mean of
    these distances over a, and half that over b. It sees modes that one of the sets lacks,
    and no weights of modes.

    Args:
        a: (N, T, d).
        b: (M, U, d).

    Returns:
        In the unit of the sets.

    Raises:
        ValueError: shapes do not match, or values are not finite.
    """
    distances = frechet_distances(a, b)
    return 0.5 * float(distances.min(axis=1).mean() + distances.min(axis=0).mean())


def frechet_distances(a: ArrayLike, b: ArrayLike) -> FloatArray:
    """Return the discrete Fréchet distance of every two trajectories (Eiter & Mannila 1994).

    The greatest distance of two points that move along the samples of a trajectory each, never
    back, at the paces that make it least.

    Args:
        a: (N, T, d).
        b: (M, U, d).

    Returns:
        (N, M), in the unit of the sets.

    Raises:
        ValueError: shapes do not match, or values are not finite.
    """
    first, second = _checked_pair(a, b, same_samples=False)
    return np.asarray(_frechet_matrix(first, second))


def rms_distances(a: ArrayLike, b: ArrayLike) -> FloatArray:
    """Return the root over time of the mean squared distance of every two trajectories.

    Args:
        a: (N, T, d).
        b: (M, T, d).

    Returns:
        (N, M), in the unit of the sets: √(mean_t |a_i(t) - b_j(t)|²).

    Raises:
        ValueError: shapes do not match, or values are not finite.
    """
    return _rms(*_checked_pair(a, b))


def energy_distance(a: FloatArray, b: FloatArray) -> float:
    """Return the energy distance 2 E|X-Y| - E|X-X'| - E|Y-Y'| of two sets, without bias.

    Source: Székely & Rizzo 2013. The means within a set leave out the distance of a draw to itself,
    so that two sets of draws from one distribution score 0 in the mean, and may score less.

    Args:
        a: (N, T, d), N at least 2; of unit u.
        b: (M, T, d), M at least 2.

    Returns:
        It, in u; distances are root mean squares over T.
    """
    within = [float(rms_distances(one, one).sum()) / (len(one) * (len(one) - 1)) for one in (a, b)]
    return 2.0 * float(rms_distances(a, b).mean()) - sum(within)


def path_lengths(trajectories: ArrayLike) -> FloatArray:
    """Return the lengths (N,) of trajectories (N, T, d), straight between samples; same unit.

    Raises:
        ValueError: the shape is another one, or values are not finite.
    """
    values = _checked("trajectories", trajectories)
    lengths: FloatArray = np.linalg.norm(np.diff(values, axis=1), axis=2).sum(axis=1)
    return lengths


def log_dimensionless_jerk(trajectories: ArrayLike) -> FloatArray:
    """Return the smoothness of trajectories: greater is smoother.

    -ln(D³ / v_peak² ∫ |d²v/dt²|² dt), v the velocity vector and D the duration (Balasubramanian et
    al. 2015, "On the analysis of movement smoothness"). Duration and size cancel out. Velocity and
    jerk are those of the quintic spline through the samples, and v_peak is taken at the samples.
    Minimum jerk along a line has -ln 204.8; corners and noise get less smooth with more samples.

    Args:
        trajectories: (N, T, d), T >= 6.

    Returns:
        (N,), no unit; without bound for uniform motion.

    Raises:
        ValueError: the shape is another one, values are not finite, or a trajectory stands still.
    """
    values = _checked("trajectories", trajectories, _JERK_DEGREE + 1)
    still = (values == values[:, :1]).all(axis=(1, 2))
    if still.any():
        raise ValueError(f"trajectories must move, got trajectory {still.argmax()} standing still")
    phase = np.linspace(0.0, 1.0, values.shape[1])
    spline = make_interp_spline(phase, values, k=_JERK_DEGREE, axis=1)
    peak = np.linalg.norm(spline(phase, 1), axis=2).max(axis=1)
    # The squared jerk is a quartic between the samples, where these three points are exact.
    nodes, weights = np.polynomial.legendre.leggauss(3)
    at = phase[:-1, None] + 0.5 * (nodes + 1.0) * np.diff(phase)[:, None]
    weight = 0.5 * weights * np.diff(phase)[:, None]
    squared = (spline(at.ravel(), 3) ** 2).sum(axis=2)
    with np.errstate(divide="ignore"):
        smoothness: FloatArray = -np.log(squared @ weight.ravel() / peak**2)
    return smoothness


def success_rates(collision_free: ArrayLike, reached: ArrayLike) -> SuccessRates:
    """Return the success rates of a set, of whole trajectories and of waypoints.

    The paper counts trajectories that reach the goal without collision, yet its percentages are no
    counts out of 20 tests of 42 trajectories; those of waypoints could be. So both are given.

    Args:
        collision_free: (N, T) bool, of each waypoint, N >= 1, T >= 1.
        reached: (N,) bool, whether the trajectory ends in the goal.

    Raises:
        ValueError: an array has another shape, or is not boolean.
    """
    free, done = np.asarray(collision_free), np.asarray(reached)
    if free.ndim != 2 or 0 in free.shape:
        raise ValueError(f"collision_free must have shape (N >= 1, T >= 1), got {free.shape}")
    if done.shape != free.shape[:1]:
        raise ValueError(f"reached must have shape ({len(free)},), got {done.shape}")
    for name, flags in (("collision_free", free), ("reached", done)):
        if flags.dtype != np.bool_:
            raise ValueError(f"{name} must be boolean, got {flags.dtype}")
    return SuccessRates(float((free.all(axis=1) & done).mean()), float(free.mean()))


def resample(trajectories: ArrayLike, samples: int = COMPARED_SAMPLES) -> FloatArray:
    """Return trajectories at other equal steps of time, straight between the given samples.

    Args:
        trajectories: (N, T, d).
        samples: how many to return, at least 2.

    Returns:
        (N, samples, d), with the same ends.

    Raises:
        ValueError: the shape is another one, values are not finite, or `samples` is too small.
    """
    values = _checked("trajectories", trajectories)
    if samples < 2:
        raise ValueError(f"samples must be at least 2, got {samples}")
    straight = make_interp_spline(np.linspace(0.0, 1.0, values.shape[1]), values, k=1, axis=1)
    resampled: FloatArray = straight(np.linspace(0.0, 1.0, samples))
    return resampled


def _checked(name: str, value: ArrayLike, samples: int = 2) -> FloatArray:
    values = np.ascontiguousarray(value, np.float64)
    if values.ndim != 3 or values.shape[1] < samples or 0 in values.shape:
        raise ValueError(
            f"{name} must have shape (N >= 1, T >= {samples}, d >= 1), got {values.shape}"
        )
    finite = np.isfinite(values)
    if not finite.all():
        trajectory = int((~finite).any(axis=(1, 2)).argmax())
        raise ValueError(
            f"{name} must be finite, got {values[~finite][0]} in trajectory {trajectory}"
        )
    return values


def _checked_pair(
    a: ArrayLike, b: ArrayLike, same_samples: bool = True
) -> tuple[FloatArray, FloatArray]:
    first, second = _checked("a", a), _checked("b", b)
    _check_alike("b", second, "a", first, same_samples)
    return first, second


def _check_alike(
    name: str, value: FloatArray, other: str, model: FloatArray, same_samples: bool
) -> None:
    first = 1 if same_samples else 2
    if value.shape[first:] != model.shape[first:]:
        raise ValueError(
            f"{name} must have the {'T and d' if same_samples else 'd'} of {other} {model.shape}, "
            f"got shape {value.shape}"
        )


def _median_distance(name: str, values: FloatArray) -> float:
    """Return the median distance of two trajectories of a set that serves as reference."""
    if len(values) < 2:
        raise ValueError(f"{name} must hold at least 2 trajectories, got shape {values.shape}")
    median = float(np.median(pdist(values.reshape(len(values), -1)))) / math.sqrt(values.shape[1])
    if median == 0.0:
        raise ValueError(
            f"{name} must hold different trajectories, got a median distance of 0 between them"
        )
    return median


def _rms(a: FloatArray, b: FloatArray) -> FloatArray:
    distances: FloatArray = cdist(a.reshape(len(a), -1), b.reshape(len(b), -1))
    return distances / math.sqrt(a.shape[1])


@kernel
def _frechet_matrix(a, b):
    distances = np.empty((a.shape[0], b.shape[0]))
    row = np.empty(b.shape[1])
    for n in range(a.shape[0]):
        for m in range(b.shape[0]):
            distances[n, m] = math.sqrt(_squared_frechet(a[n], b[m], row))
    return distances


@kernel
def _squared_frechet(first, second, row):
    """Return the squared distance of (T,d) and (U,d); `row` (U,) is overwritten.

    `row[j]` is what it costs to get to sample j of the second and the present one of the first.
    """
    row[:] = np.inf
    for i in range(first.shape[0]):
        diagonal = 0.0 if i == 0 else np.inf
        left = np.inf
        for j in range(second.shape[0]):
            square = 0.0
            for k in range(first.shape[1]):
                square += (first[i, k] - second[j, k]) ** 2
            left = max(square, min(diagonal, row[j], left))
            diagonal = row[j]
            row[j] = left
    return row[-1]
