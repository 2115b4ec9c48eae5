"""Against scipy's quintic, geometry, and the exact check."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.interpolate import BPoly

from smp_gym.scene import Obstacle
from smp_planner.collision.edge_check import EdgeChecker
from smp_planner.collision.verification import check_collisions
from smp_planner.planners.rrt_connect.shortcutting import (
    minimum_jerk,
    path_length,
    shortcut,
    smooth,
    stop_at_corners,
)

VELOCITY = np.array([1.0, 2.0])


PILLAR = Obstacle(shape="cylinder", position=(1.5, 0.0, 0.0), size=(0.1, 0.1, 1.0))
# Around the pillar with a folded elbow, by more of a detour than is needed.
DETOUR = np.array([[-1.0, 0.0], [-1.2, 1.0], [-0.6, 2.6], [0.4, 2.9], [1.3, 1.5], [1.0, 0.0]])


def distance_to_path(points, path):
    """(N,) distance of points to a polyline, by projection on each edge."""
    best = np.full(len(points), np.inf)
    for a, b in pairwise(path):
        length = max(float((b - a) @ (b - a)), 1e-300)
        share = np.clip((points - a) @ (b - a) / length, 0.0, 1.0)
        best = np.minimum(best, np.linalg.norm(points - a - share[:, None] * (b - a), axis=1))
    return best


def test_without_obstacles_the_straight_edge_is_left(planar):
    checker = EdgeChecker(planar, ())
    short = shortcut(DETOUR, checker, 0, np.random.default_rng(0))
    np.testing.assert_array_equal(short, DETOUR[[0, -1]])


def test_around_an_obstacle_the_path_gets_shorter_and_stays_free(planar):
    checker = EdgeChecker(planar, (PILLAR,), 0.005)
    assert checker.edges_free(DETOUR[:-1], DETOUR[1:]).all()
    assert not checker.edges_free(DETOUR[:1], DETOUR[-1:])[0]
    lengths = []
    for iterations in (0, 300):
        short = shortcut(DETOUR, checker, iterations, np.random.default_rng(0))
        np.testing.assert_array_equal(short[[0, -1]], DETOUR[[0, -1]])
        check = check_collisions(short[None], planar, (PILLAR,))
        assert check.free[0]
        assert check.clearance[0] >= 0.005
        lengths.append(path_length(short))
    assert lengths[1] < lengths[0] <= path_length(DETOUR)
    # A path of the visibility graph's kind touches the obstacle: no free room is given away.
    assert check.clearance[0] < 0.02


def test_the_length_of_a_path():
    assert path_length([[0.0, 0.0], [3.0, 4.0], [3.0, 5.0]]) == pytest.approx(6.0)


def test_minimum_jerk_is_the_quintic_between_rests():
    phase = np.linspace(0.0, 1.0, 101)
    quintic = BPoly.from_derivatives([0.0, 1.0], [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    np.testing.assert_allclose(minimum_jerk(phase), quintic(phase), atol=1e-12)


@pytest.mark.parametrize("points", [2, 3, 7, 40])
def test_a_smooth_trajectory_rests_at_the_path_s_ends(points):
    trajectory = smooth(DETOUR, VELOCITY, points, 200)
    assert trajectory.shape == (200, 2)
    np.testing.assert_array_equal(trajectory[[0, -1]], DETOUR[[0, -1]])
    speed = np.linalg.norm(np.diff(trajectory, axis=0), axis=1)
    assert speed[[0, -1]].max() < 0.01 * speed.max()
    assert (trajectory >= DETOUR.min(0)).all()
    assert (trajectory <= DETOUR.max(0)).all()


def test_more_control_points_keep_nearer_to_the_path():
    away = [distance_to_path(smooth(DETOUR, VELOCITY, n, 400), DETOUR).max() for n in (7, 28, 200)]
    assert away[0] > away[1] > away[2]
    assert away[2] < 0.02


def test_a_smooth_trajectory_has_no_corner():
    """Where the path turns at once, the trajectory's direction changes little from step to step."""
    trajectory = smooth(DETOUR, VELOCITY, 14, 2000)
    steps = np.diff(trajectory, axis=0)[100:-100]
    steps /= np.linalg.norm(steps, axis=1, keepdims=True)
    assert np.arccos(np.clip((steps[:-1] * steps[1:]).sum(1), -1, 1)).max() < 0.05


def test_stopping_at_corners_keeps_to_the_path_exactly():
    trajectory = stop_at_corners(DETOUR, VELOCITY, 200)
    assert trajectory.shape == (200, 2)
    assert distance_to_path(trajectory, DETOUR).max() < 1e-12
    speed = np.linalg.norm(np.diff(trajectory, axis=0), axis=1)
    for corner in DETOUR:
        nearest = np.abs(trajectory - corner).max(axis=1)
        at = int(nearest.argmin())
        assert nearest[at] < 1e-12
        assert speed[max(at - 1, 0) : at + 1].max() < 0.05 * speed.max()


def test_time_is_shared_among_edges_by_the_velocity_limits():
    # One radian of the first joint takes as long as two of the second.
    path = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 2.0]])
    trajectory = stop_at_corners(path, VELOCITY, 201)
    np.testing.assert_allclose(trajectory[100], path[1], atol=1e-12)


def test_repeated_corners_do_no_harm():
    path = DETOUR[[0, 0, 1, 2, 2, 2, 3]]
    for trajectory in (smooth(path, VELOCITY, 14, 200), stop_at_corners(path, VELOCITY, 200)):
        assert trajectory.shape == (200, 2)
        np.testing.assert_array_equal(trajectory[[0, -1]], path[[0, -1]])
    still = DETOUR[[2, 2]]
    np.testing.assert_array_equal(smooth(still, VELOCITY, 7, 9), np.repeat(still[:1], 9, 0))
    np.testing.assert_array_equal(stop_at_corners(still, VELOCITY, 9), np.repeat(still[:1], 9, 0))


@pytest.mark.parametrize("path", [np.zeros(2), np.zeros((1, 2)), np.array([[0.0, 0], [np.nan, 1]])])
def test_a_path_has_two_finite_configurations_or_more(planar, path):
    with pytest.raises(ValueError, match="path"):
        shortcut(path, EdgeChecker(planar, ()), 1, np.random.default_rng(0))
    with pytest.raises(ValueError, match="path"):
        smooth(path, VELOCITY, 7, 200)
    with pytest.raises(ValueError, match="path"):
        stop_at_corners(path, VELOCITY, 200)


def test_a_spline_needs_two_points_and_each_edge_a_step():
    with pytest.raises(ValueError, match=r"points.*1"):
        smooth(DETOUR, VELOCITY, 1, 200)
    with pytest.raises(ValueError, match=r"at most 4 edges, got 5"):
        stop_at_corners(DETOUR, VELOCITY, 5)
