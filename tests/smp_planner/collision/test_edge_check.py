"""Against the analytic gap of a planar arm, and against dense sampling in plain numpy."""

import numpy as np
import pytest

from smp_gym.geometry.distance import signed_distance
from smp_gym.robot.kinematics import (
    arm_spheres,
    box_spheres,
    concatenate,
    finger_spheres,
    sphere_centers,
)
from smp_gym.scene import Obstacle
from smp_planner.collision.edge_check import EdgeChecker
from smp_planner.collision.robot_model import jaco_model, jaco_of_spheres
from smp_planner.collision.verification import CLEARANCE_TOLERANCE, check_collisions

MARGIN = 0.005


def post(gap, angle=0.61):
    """A ball outside the pointer's circle, at its nearest `gap` away from the pointer's sphere."""
    distance = 1.0 + 0.1 + gap + 0.05
    position = (distance * np.cos(angle), distance * np.sin(angle), 0.0)
    return Obstacle(shape="sphere", position=position, size=(0.05, 0.05, 0.05))


@pytest.mark.parametrize(
    ("gap", "free"), [(-0.02, False), (0.004, False), (0.0061, True), (0.03, True)]
)
def test_a_pointer_passes_what_it_keeps_the_margin_to(pointer, gap, free):
    checker = EdgeChecker(pointer(), (post(gap),), MARGIN)
    assert checker.configurations_free([[0.0], [1.4]]).all()
    assert checker.edges_free([[0.0], [1.4]], [[1.4], [0.0]]).tolist() == [free, free]
    assert checker.configurations_free([[0.61]])[0] == free


@pytest.mark.parametrize("length", [0.2, 0.7, 2.6])
def test_no_obstacle_is_so_small_that_an_edge_steps_over_it(pointer, length):
    thin = pointer(radius=0.005)
    for angle in np.linspace(0.03, 0.97, 40) * length:
        position = (np.cos(angle), np.sin(angle), 0.0)
        grain = Obstacle(shape="sphere", position=position, size=(0.002,) * 3)
        checker = EdgeChecker(thin, (grain,))
        edges = np.array([[0.0], [length]])
        if checker.configurations_free(edges).all():
            assert not checker.edges_free(edges, edges[::-1]).any()


def test_without_obstacles_all_is_free(pointer):
    assert EdgeChecker(pointer(), ()).edges_free([[-3.0]], [[3.0]])[0]


@pytest.fixture(scope="module")
def arm(placement, crowded):
    problem = placement(crowded)
    return problem.robot, problem.obstacles, problem.start


@pytest.fixture(scope="module")
def edges(arm):
    """300 random edges (2, 300, 6) of up to a radian."""
    rng = np.random.default_rng(0)
    robot, _, start = arm
    starts = np.clip(start + rng.uniform(-2.5, 2.5, (300, 6)), robot.lower, robot.upper)
    steps = rng.standard_normal((300, 6))
    steps *= rng.uniform(0.05, 1.0, (300, 1)) / np.linalg.norm(steps, axis=1, keepdims=True)
    return starts, starts + steps


def sampled_gaps(robot, obstacles, starts, ends, samples=200):
    """Least gap to obstacles and of the arm to itself on each edge, by sampling in numpy."""
    outside, inside = [], []
    moving = robot.link > 0
    first, second = robot.collision_pairs.T
    for a, b in zip(starts, ends, strict=True):
        shares = np.linspace(0.0, 1.0, samples)[:, None]
        centers = sphere_centers(a + shares * (b - a), robot.spheres)
        distances = signed_distance(centers[:, moving], obstacles) - robot.radius[moving]
        outside.append(distances.min())
        between = np.linalg.norm(centers[:, first] - centers[:, second], axis=-1)
        inside.append((between - robot.radius[first] - robot.radius[second]).min())
    return np.array(outside), np.array(inside)


def test_edges_are_free_just_where_dense_sampling_says_so(arm, edges):
    robot, obstacles, _ = arm
    free = EdgeChecker(robot, obstacles, MARGIN).edges_free(*edges)
    outside, inside = sampled_gaps(robot, obstacles, *edges)
    assert 50 < free.sum() < 250
    assert (outside[free] >= MARGIN).all()
    assert (inside[free] >= CLEARANCE_TOLERANCE).all()
    # Steps of 5 mrad let samples miss a deepest point by less than half a millimetre.
    clear = (outside > MARGIN + CLEARANCE_TOLERANCE + 5e-4) & (
        inside > 2 * CLEARANCE_TOLERANCE + 5e-4
    )
    assert clear[~free].sum() == 0
    assert (~free).sum() > 50


def test_what_is_free_here_is_free_for_the_verification(arm, edges):
    robot, obstacles, _ = arm
    free = EdgeChecker(robot, obstacles).edges_free(*edges)
    paths = np.stack(edges, axis=1)
    assert check_collisions(paths[free], robot, obstacles).free.all()


def test_configurations_are_checked_as_they_are(arm, edges):
    robot, obstacles, _ = arm
    q = edges[0]
    free = EdgeChecker(robot, obstacles, MARGIN).configurations_free(q)
    outside, inside = sampled_gaps(robot, obstacles, q, q, samples=1)
    assert (
        free == ((outside >= MARGIN + CLEARANCE_TOLERANCE) & (inside >= 2 * CLEARANCE_TOLERANCE))
    ).all()
    assert 50 < free.sum() < 250


def test_the_direction_of_an_edge_does_not_matter_for_what_is_certain(arm, edges):
    robot, obstacles, _ = arm
    checker = EdgeChecker(robot, obstacles, MARGIN)
    starts, ends = edges
    differing = checker.edges_free(starts, ends) != checker.edges_free(ends, starts)
    assert differing.mean() <= 0.01


@pytest.mark.parametrize("margin", [0.0, -0.01, np.nan, np.inf])
def test_a_margin_below_the_tolerance_is_refused(pointer, margin):
    with pytest.raises(ValueError, match="margin"):
        EdgeChecker(pointer(), (), margin)


@pytest.mark.parametrize("wrong", [np.zeros(6), np.zeros((2, 5)), np.full((1, 6), np.nan)])
def test_configurations_must_fit_the_robot_and_be_finite(arm, wrong):
    robot, obstacles, _ = arm
    checker = EdgeChecker(robot, obstacles)
    with pytest.raises(ValueError, match="configurations"):
        checker.configurations_free(wrong)
    with pytest.raises(ValueError, match="starts"):
        checker.edges_free(wrong, np.zeros((1, 6)))
    with pytest.raises(ValueError, match="ends"):
        checker.edges_free(np.zeros((3, 6)), np.zeros((2, 6)))


def test_what_moves_in_two_stages_keeps_the_margin_to_its_own_obstacles_only(arm, edges):
    """Against a checker for each stage, and one for what the stages together must not do."""
    _, obstacles, _ = arm
    held = np.eye(4)
    held[0, 3] = 0.05
    hand = concatenate(arm_spheres(), finger_spheres((0.5, 0.5, 0.3, 0.3)))
    box = box_spheres((0.03, 0.03, 0.06), held)
    bodies = [(jaco_of_spheres(hand), obstacles[:2]), (jaco_of_spheres(box), obstacles[1:])]
    together = EdgeChecker.of_all(bodies, MARGIN).edges_free(*edges)
    whole = jaco_model(concatenate(finger_spheres((0.5, 0.5, 0.3, 0.3)), box))
    apart = [EdgeChecker(robot, near, MARGIN).edges_free(*edges) for robot, near in bodies]
    alone = EdgeChecker(whole, ()).edges_free(*edges)
    np.testing.assert_array_equal(together, apart[0] & apart[1] & alone)
    all_of_all = EdgeChecker(whole, obstacles, MARGIN).edges_free(*edges)
    assert (together & ~all_of_all).any()
    assert (apart[0] & ~apart[1]).any()
    assert (apart[1] & ~apart[0]).any()
