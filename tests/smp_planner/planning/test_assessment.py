"""What a plan says of its particles: their order, homotopy classes, the best of each mode."""

from dataclasses import replace

import gymnasium
import numpy as np
import pytest

import smp_gym  # noqa: F401  (registers the environments)
from smp_gym.geometry.distance import signed_distance
from smp_gym.observation import decode
from smp_gym.robot.kinematics import (
    arm_spheres,
    concatenate,
    end_effector_pose,
    finger_spheres,
    sphere_centers,
)
from smp_gym.scene import Obstacle
from smp_planner.collision.verification import CLEARANCE_TOLERANCE
from smp_planner.planners import make_planner
from smp_planner.planning.assessment import free_waypoints, signatures
from smp_planner.planning.modes import group
from smp_planner.planning.plan import Plan
from smp_planner.planning.problem import arm_problem
from smp_planner.planning.ranking import Merits, rank
from smp_planner.planning.tool_goals import GoalRegion
from smp_planner.policy.observed_problem import problem_from

POSTURE = np.array([0.0, 3.6, 1.6, 1.5, 1.5, 1.0])
FINGERS = finger_spheres((0.0, 0.0, 0.0, 0.0))
QUARTER = np.pi / 2


def turning(*angles, count=200):
    """Return trajectories (P, count, 6) that turn the first joint from 0 by each of the angles."""
    paths = np.tile(POSTURE, (len(angles), count, 1))
    paths[..., 0] += np.linspace(0.0, 1.0, count) * np.array(angles)[:, None]
    return paths


def hand(angle):
    return end_effector_pose(POSTURE + np.array([angle, 0, 0, 0, 0, 0]))[:3, 3]


def around(place, half=0.01):
    return GoalRegion(np.zeros(3), place - half, place + half)


def pole(place, height):
    return Obstacle(shape="cylinder", position=tuple(place), size=(0.05, 0.05, height))


def problem_with(movable, goals):
    return arm_problem(POSTURE, movable, FINGERS, goals, seed=0, movable=movable)


def signatures_of(trajectories, movable, goals):
    return signatures(problem_with(movable, goals), trajectories)


def test_two_ways_round_the_base_wind_round_it_once():
    """A turn by a quarter and by a quarter less a whole turn end in one place."""
    trajectories = turning(QUARTER, QUARTER - 2 * np.pi)
    found = signatures_of(trajectories, (pole((0.0, 0.0, 0.5), 1.0),), (around(hand(QUARTER)),))
    assert found.shape == (2, 3)
    np.testing.assert_array_equal(found[:, 0], 0)
    np.testing.assert_array_equal(found[:, 2], 0)
    # The hand goes round the origin as the joint does: a positive angle is clockwise for JACO.
    sense = np.sign(np.cross(hand(0.0), hand(0.1))[2])
    np.testing.assert_array_equal(found[:, 1], [0, -sense])


@pytest.mark.parametrize(("offset", "level"), [(-0.2, 1), (0.0, 0), (0.2, -1)])
def test_over_and_under_an_obstacle(offset, level):
    place = hand(QUARTER / 2) + np.array([0.0, 0.0, offset])
    found = signatures_of(turning(QUARTER), (pole(place, 0.1),), (around(hand(QUARTER)),))
    assert found[0, 2] == level


@pytest.mark.parametrize("lean", [0.0, 0.7])
def test_an_obstacle_is_as_high_as_it_leans(lean):
    """A box 2 cm thick and 20 cm long, tilted: the highest corner decides what is over it."""
    half, thin = 0.10, 0.01
    top = half * np.sin(lean) + thin * np.cos(lean)
    for gap, level in ((-0.002, 0), (0.002, 1)):
        middle = hand(QUARTER / 2) - np.array([0.0, 0.0, top + gap])
        box = Obstacle(
            shape="box",
            position=tuple(middle),
            quaternion=(0.0, np.sin(lean / 2), 0.0, np.cos(lean / 2)),
            size=(half, thin, thin),
        )
        assert signatures_of(turning(QUARTER), (box,), (around(hand(QUARTER)),))[0, 2] == level


def test_a_path_through_the_middle_of_an_obstacle_has_a_signature_all_the_same():
    place = hand(0.0)
    found = signatures_of(turning(QUARTER), (pole(place, 0.1),), (around(hand(QUARTER)),))
    assert found.shape == (1, 3)


def test_ways_to_two_goals_differ_whatever_is_between():
    trajectories = turning(0.5, -0.5, 0.5)
    found = signatures_of(trajectories, (), (around(hand(-0.5)), around(hand(0.5))))
    np.testing.assert_array_equal(found, [[1], [0], [1]])


def test_the_order_is_that_of_what_is_demanded_and_then_of_likeness():
    free = np.array([True, True, False, True])
    merits = Merits(
        free=free,
        passing=np.ones(4, bool),
        executable=np.array([True, True, True, False]),
        clearance=np.array([0.02, 0.02, -0.01, 0.02]),
        missed={},
        costs={"prior": np.array([5.0, 3.0, 0.0, 1.0])},
    )
    places = rank(merits)
    np.testing.assert_array_equal(places, [1, 0, 3, 2])


@pytest.fixture
def plan():
    """Six particles of which the second is not good: classes of 3 and 2 good ones."""
    count = 6
    return Plan(
        trajectories=np.zeros((count, 200, 6)),
        costs={},
        collision_free=np.array([True, False, True, True, True, True]),
        clearance=np.zeros(count),
        missed={},
        passing=np.ones(count, bool),
        duration=np.ones(count),
        executable=np.ones(count, bool),
        signatures=np.array([[0, 1], [0, 1], [0, 2], [0, 1], [0, 2], [0, 2]]),
        ranks=np.array([2, 0, 4, 1, 3, 5]),
    )


def test_modes_are_those_of_good_particles(plan):
    modes = plan.modes
    assert modes.count == 2
    np.testing.assert_array_equal(modes.signatures, [[0, 2], [0, 1]])
    np.testing.assert_allclose(modes.shares, [0.6, 0.4])
    np.testing.assert_array_equal(plan.best_of_modes, [4, 3])


def test_a_plan_without_good_particles_has_no_mode(plan):
    bad = replace(plan, collision_free=np.zeros(6, bool))
    assert bad.modes.count == 0
    assert bad.modes.entropy == 0.0
    assert len(bad.best_of_modes) == 0


def test_a_planner_tells_the_modes_of_what_it_planned():
    env = gymnasium.make("smp_gym/DoubleSidedPlacement-v0", difficulty="easy")
    observation, _ = env.reset(seed=1)
    env.close()
    decoded = decode(observation, "DoubleSidedPlacement")
    problem = problem_from(decoded, seed=0)
    assert problem.movable == decoded.scene.obstacles
    (plan,) = make_planner("smp", "DoubleSidedPlacement").plan([problem])
    assert plan.signatures.shape == (42, 1 + 2 * len(decoded.scene.obstacles))
    # Each component has its own side, and so is the first entry.
    np.testing.assert_array_equal(plan.signatures[plan.good, 0], plan.components[plan.good])
    assert plan.ranks[plan.chosen] == 0
    assert plan.chosen in plan.best_of_modes
    assert plan.modes.count == group(plan.signatures[plan.good]).count >= 2


def test_waypoints_are_free_where_spheres_keep_clear():
    """Checked sphere by sphere, with nothing of the planner's own checker."""
    obstacle = pole(hand(QUARTER / 2) - np.array([0.0, 0.0, 0.1]), 0.1)
    problem = problem_with((obstacle,), (around(hand(QUARTER)),))
    trajectories = turning(QUARTER, 0.3, count=60)
    spheres = concatenate(arm_spheres(), FINGERS)
    moving = spheres.link > 0
    centers = sphere_centers(trajectories.reshape(-1, 6), spheres)[:, moving]
    clearance = (signed_distance(centers, (obstacle,)) - spheres.radius[moving]).min(axis=1)
    gap = clearance.reshape(2, 60)
    found = free_waypoints(problem, trajectories)
    assert (gap[0] > 2 * CLEARANCE_TOLERANCE).any()
    assert (gap[0] < 0).any()
    # Between once and twice the tolerance, either answer is right.
    assert found[gap > 2 * CLEARANCE_TOLERANCE].all()
    assert not found[gap < CLEARANCE_TOLERANCE].any()
