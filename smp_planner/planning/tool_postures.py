"""Postures in which a robot's tool has a place and an orientation, of all branches, the likeliest.

From many configurations within the limits, damped least squares leads to postures that satisfy
what is asked; from each, Gauss-Newton to the likeliest one nearby. What is asked is a region, so
nothing is pulled that lies well inside.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.stats import qmc

from smp_gym.arrays import FloatArray
from smp_gym.robot.kinematics import UnreachableError, damped_step
from smp_planner.collision.robot_model import RobotModel
from smp_planner.planning.robot_body import RobotBody
from smp_planner.planning.tool_goals import GoalRegion, ToolViaPoint
from smp_planner.planning.tool_orientations import inner_angle

__all__ = ["drawn_postures", "posture_information", "postures_at"]

MOST_POSTURES = 4
"""Postures of one constraint that a primitive is conditioned on; less likely ones are left out."""

INNER = 0.5
"""Share of a region within which postures are sought, so that there is room around them."""

_REACHED = 1e-3
"""m and rad up to which a posture is taken to have what is asked."""

_LEAST_STD, _MOST_STD = 1e-3, 5e-3
"""Least and largest standard deviation, m, with which a primitive is conditioned on a place."""

_LEAST_ANGLE_STD, _MOST_ANGLE_STD = 2e-3, 0.1
"""Likewise, rad, on an orientation."""

_POSTURE_STD = 0.1
"""rad, that joints keep around a posture: within it the tool moves about linearly."""

_APART = 0.5
"""rad, by which a joint of two postures differs that count as two branches."""

_STARTS = 32
"""Configurations within the limits from which postures are sought, beside the expected one."""

_APPROACH, _IMPROVE = 60, 15
"""Iterations of damped least squares, and of Gauss-Newton."""

_DAMPING = 1e-4
_LARGEST_STEP = 0.3
"""rad, of Gauss-Newton."""

_LEAST_VARIANCE = 1e-6
"""rad², added to the variance of joints of which a primitive is certain."""


def postures_at(
    name: str,
    mean: FloatArray,
    covariance: FloatArray,
    places: Sequence[GoalRegion | ToolViaPoint],
    robot: RobotModel,
) -> list[tuple[int, FloatArray]]:
    """Return postures that have one of several places, the likeliest under a Gaussian first.

    Args:
        name: what the user calls the constraint, for the message.
        mean: (n,) rad.
        covariance: (n, n) rad².
        places: at least one.
        robot: the arm.

    Returns:
        At most `MOST_POSTURES` pairs of the number of a place and a posture (n,) rad within the
        limits; of each place that is reached the likeliest posture, then others. Postures in which
        the arm touches itself are left out where there are others.

    Raises:
        UnreachableError: no place is reached; the message says how far the nearest posture stays
            away, and which joints are at their limits there.
    """
    precision = np.asarray(np.linalg.inv(covariance + _LEAST_VARIANCE * np.eye(len(mean))))
    starts = _starts(mean, robot)
    found: list[tuple[bool, bool, float, int, FloatArray]] = []
    for number, place in enumerate(places):
        q = _approached(starts, place, robot)
        q = q[_violation(q, place, robot) <= _REACHED]
        q = np.concatenate([q, _improved(q, mean, precision, place, robot)])
        q = _nearest_turns(q, mean, robot)
        q = q[_violation(q, place, robot) <= _REACHED]
        energy = np.einsum("pi,ij,pj->p", q - mean, precision, q - mean)
        touching = ~RobotBody(robot).check(q[:, None], ()).free if len(q) else np.empty(0, bool)
        kept: list[FloatArray] = []
        for index in np.lexsort((energy, touching)):
            if all(np.abs(q[index] - other).max() > _APART for other in kept):
                # The likeliest of a place before all others.
                rest = bool(kept)
                found.append((bool(touching[index]), rest, float(energy[index]), number, q[index]))
                kept.append(q[index])
    if not found:
        raise UnreachableError(_what_binds(name, starts, places, robot))
    found.sort(key=lambda entry: entry[:4])
    # What touches itself is left out, unless nothing else is left.
    clear = [entry for entry in found if not entry[0]] or found
    return [(number, posture) for *_, number, posture in clear[:MOST_POSTURES]]


def drawn_postures(
    name: str,
    places: Sequence[GoalRegion | ToolViaPoint],
    robot: RobotModel,
    near: FloatArray,
    count: int,
    rng: np.random.Generator,
) -> FloatArray:
    """Return postures that have one of several places with its orientation, from random starts.

    Damped least squares over all joints, from configurations drawn evenly within the limits, into
    the inner half of what is asked. The places take turns. What does not get there is left out.

    Args:
        name: what the user calls the constraint, for the message.
        places: at least one.
        robot: the arm.
        near: (n,) rad; endless joints are turned to be within half a turn of it.
        count: of starts.
        rng: source of all randomness.

    Returns:
        (G, n) rad, G from 1 to `count`, within the limits, in the order of the starts; the tool has
        place and orientation up to 1e-3 m and rad. They are not checked for collisions.

    Raises:
        UnreachableError: no place is reached; see `postures_at`.
    """
    lower = np.where(robot.endless, np.maximum(robot.lower, near - np.pi), robot.lower)
    upper = np.where(robot.endless, np.minimum(robot.upper, near + np.pi), robot.upper)
    starts = rng.uniform(lower, upper, (count, robot.joints))
    q, reached = starts.copy(), np.zeros(count, np.bool_)
    of_place = np.arange(count) % len(places)
    for number, place in enumerate(places[:count]):
        mine = of_place == number
        q[mine] = _nearest_turns(_approached(starts[mine], place, robot), near, robot)
        reached[mine] = _violation(q[mine], place, robot) <= _REACHED
    if not reached.any():
        raise UnreachableError(_what_binds(name, starts, places, robot))
    return q[reached]


def posture_information(
    place: GoalRegion | ToolViaPoint, posture: FloatArray, robot: RobotModel
) -> FloatArray:
    """Return the information (n, n) 1/rad² on joints near a posture (n,) that has a place.

    It keeps the tool within the place and its orientation, and the joints within about 0.1 rad.
    """
    jacobian = robot.carried_points(posture, place.point)[1] / _stds(place)[:, None]
    information = jacobian.T @ jacobian + np.eye(len(posture)) / _POSTURE_STD**2
    if place.orientation is not None:
        rotation, axes = robot.tool_rotations(posture)
        std = np.clip(_room(place.orientation.allowed), _LEAST_ANGLE_STD, _MOST_ANGLE_STD)
        turns = place.orientation.bound(rotation) @ axes / std
        information = information + turns.T @ turns
    return np.asarray(information)


def _room(half: FloatArray | float) -> FloatArray:
    """Return a third of what lies between the inner share of a half extent and the border."""
    return np.asarray((1.0 - INNER) * half / 3.0)


def _stds(place: GoalRegion | ToolViaPoint) -> FloatArray:
    """Return the standard deviations (3,) m with which a primitive is conditioned on a place."""
    half = _half(place)
    if isinstance(place, ToolViaPoint):
        half = half / np.sqrt(3.0)
    return np.clip(_room(half), _LEAST_STD, _MOST_STD)


def _half(place: GoalRegion | ToolViaPoint) -> FloatArray:
    """Return the half extents (3,) m of a place."""
    if isinstance(place, GoalRegion):
        return (place.upper - place.lower) / 2
    return np.full(3, place.tolerance)


def _starts(mean: FloatArray, robot: RobotModel) -> FloatArray:
    """Return configurations (1 + N, n) rad: the expected one, then some all over the limits."""
    lower = np.where(robot.endless, np.maximum(robot.lower, mean - np.pi), robot.lower)
    upper = np.where(robot.endless, np.minimum(robot.upper, mean + np.pi), robot.upper)
    spread = qmc.Halton(len(mean), scramble=False).random(_STARTS + 1)[1:]
    expected = np.clip(mean, robot.lower, robot.upper)
    return np.concatenate([expected[None], lower + spread * (upper - lower)])


def _errors(
    q: FloatArray, place: GoalRegion | ToolViaPoint, robot: RobotModel
) -> tuple[FloatArray, FloatArray]:
    """Return what (P, 3 or 6), m and rad, leads tools into the inner region, with Jacobians."""
    points, jacobian = robot.carried_points(q, place.point)
    offset = points - place.center
    if isinstance(place, GoalRegion):
        error = offset - np.clip(offset, -INNER * _half(place), INNER * _half(place))
    else:
        away = np.linalg.norm(offset, axis=-1, keepdims=True)
        error = offset * (1.0 - np.minimum(1.0, INNER * place.tolerance / np.maximum(away, 1e-12)))
    if place.orientation is None:
        return -error, jacobian
    rotations, axes = robot.tool_rotations(q)
    angle, about = place.orientation.turned(rotations)
    beyond = np.maximum(angle - inner_angle(place.orientation, INNER), 0.0)
    return (
        -np.concatenate([error, beyond[:, None] * about], axis=1),
        np.concatenate([jacobian, _relevant(place, rotations) @ axes], axis=1),
    )


def _relevant(place: GoalRegion | ToolViaPoint, rotations: FloatArray) -> FloatArray:
    assert place.orientation is not None
    return np.stack([place.orientation.bound(rotation) for rotation in rotations])


def _approached(q: FloatArray, place: GoalRegion | ToolViaPoint, robot: RobotModel) -> FloatArray:
    """Return configurations (P, n) rad moved towards a place by damped least squares."""
    for _ in range(_APPROACH):
        error, jacobian = _errors(q, place, robot)
        if np.abs(error).max() < _REACHED / 10.0:
            break
        step = damped_step(jacobian, error, np.full(len(q), _DAMPING))
        q = np.clip(q + step, robot.lower, robot.upper)
    return q


def _improved(
    q: FloatArray,
    mean: FloatArray,
    precision: FloatArray,
    place: GoalRegion | ToolViaPoint,
    robot: RobotModel,
) -> FloatArray:
    """Return the likeliest postures (P, n) rad near to those that have a place.

    Gauss-Newton on the negative log-posterior, given that the tool is in the middle of what is
    asked, up to a third of its half extents.
    """
    std = np.maximum(_half(place) / 3.0, _LEAST_STD)
    for _ in range(_IMPROVE if len(q) else 0):
        points, jacobian = robot.carried_points(q, place.point)
        residual, rows = (points - place.center) / std, jacobian / std[:, None]
        if place.orientation is not None:
            rotations, axes = robot.tool_rotations(q)
            angle, about = place.orientation.turned(rotations)
            angle_std = max(place.orientation.allowed / 3.0, _LEAST_ANGLE_STD)
            turns = _relevant(place, rotations) @ axes
            residual = np.concatenate([residual, angle[:, None] * about / angle_std], axis=1)
            rows = np.concatenate([rows, turns / angle_std], axis=1)
        transposed = np.swapaxes(rows, -1, -2)
        slope = (transposed @ residual[..., None])[..., 0] + (q - mean) @ precision
        step = np.linalg.solve(transposed @ rows + precision, slope[..., None])[..., 0]
        size = np.abs(step).max(axis=-1, keepdims=True)
        step = step * np.minimum(1.0, _LARGEST_STEP / np.maximum(size, 1e-12))
        q = np.clip(q - step, robot.lower, robot.upper)
    return q


def _nearest_turns(q: FloatArray, mean: FloatArray, robot: RobotModel) -> FloatArray:
    """Return configurations (P, n) rad with endless joints within half a turn of the mean."""
    turns = np.where(robot.endless, np.round((q - mean) / (2.0 * np.pi)), 0.0)
    turned = q - 2.0 * np.pi * turns
    return np.where((turned >= robot.lower) & (turned <= robot.upper), turned, q)


def _what_binds(
    name: str,
    starts: FloatArray,
    places: Sequence[GoalRegion | ToolViaPoint],
    robot: RobotModel,
) -> str:
    """Return a message on places that no posture has: the nearest posture, and what stops it."""
    best: tuple[float, str] | None = None
    for place in places:
        q = _approached(starts, place, robot)
        missed = place.distance(robot.carried_points(q, place.point)[0])
        turned = np.zeros(len(q))
        if place.orientation is not None:
            angle = place.orientation.turned(robot.tool_rotations(q)[0])[0]
            turned = np.maximum(angle - place.orientation.allowed, 0.0)
        nearest = int((missed + turned).argmin())
        away = float(missed[nearest] + turned[nearest])
        if best is not None and away >= best[0]:
            continue
        said = f"{name} {np.round(place.center, 3)} is out of reach: the arm stays "
        said += f"{missed[nearest]:.3f} m away"
        if place.orientation is not None:
            said += f" and turned {turned[nearest]:.3f} rad too far"
        margin = np.minimum(q[nearest] - robot.lower, robot.upper - q[nearest])
        at = [str(joint + 1) for joint in np.flatnonzero(margin <= _REACHED)]
        if at:
            said += f", with joint{'s' if len(at) > 1 else ''} {', '.join(at)} of "
            said += f"{robot.joints} at the limits"
        if place.orientation is not None:
            free = replace(place, orientation=None)
            alone = _violation(_approached(starts, free, robot), free, robot).min() <= _REACHED
            said += (
                f"; with the orientation free it is {'within' if alone else 'out of'} reach, too"
            )
            said = said if not alone else said.removesuffix(", too")
        best = away, said
    assert best is not None
    return best[1]


def _violation(q: FloatArray, place: GoalRegion | ToolViaPoint, robot: RobotModel) -> FloatArray:
    """Return by how much (P,), m and rad, tools miss a place and its orientation at most."""
    missed = place.distance(robot.carried_points(q, place.point)[0])
    if place.orientation is None:
        return missed
    angle = place.orientation.turned(robot.tool_rotations(q)[0])[0]
    return np.maximum(missed, angle - place.orientation.allowed)
