"""Against dense sampling in numpy, and OMPL's RRT-Connect."""

from itertools import pairwise

import numpy as np
import pytest

from smp_gym.geometry.distance import signed_distance
from smp_gym.robot.kinematics import sphere_centers
from smp_gym.scene import Obstacle
from smp_planner.collision.edge_check import EdgeChecker
from smp_planner.planners.rrt_connect.shortcutting import path_length
from smp_planner.planners.rrt_connect.tree_search import rrt_connect
from smp_planner.planning.postures import reaching


@pytest.fixture(scope="module")
def problem(placement, crowded):
    return placement(crowded)


@pytest.fixture(scope="module")
def goals(problem, checker, postures):
    """Free configurations at the goal, (G,6) rad."""
    rng = np.random.default_rng(0)
    seeds = postures[rng.integers(len(postures), size=64)] + 0.2 * rng.standard_normal((64, 6))
    found = reaching(problem.goals, checker.robot, seeds, problem.start, rng)
    return found[checker.configurations_free(found)]


def test_a_path_is_free_from_start_to_goal(problem, goals, checker):
    """Sampled finely, with nothing of the planner's own checker."""
    assert not checker.edges_free(np.tile(problem.start, (len(goals), 1)), goals).any()
    path = rrt_connect(problem.start, goals, checker, np.random.default_rng(0))
    np.testing.assert_array_equal(path[0], problem.start)
    assert (path[-1] == goals).all(axis=1).any()
    assert np.linalg.norm(np.diff(path, axis=0), axis=1).max() <= 0.5 + 1e-9
    spheres = problem.robot.spheres
    moving = spheres.link > 0
    for a, b in pairwise(path):
        fine = np.linspace(a, b, 100)
        centers = sphere_centers(fine, spheres)[:, moving]
        assert (signed_distance(centers, problem.obstacles) - spheres.radius[moving]).min() >= 0.005


def test_in_free_space_the_way_is_straight(problem):
    free = EdgeChecker(problem.robot, ())
    goal = problem.start + np.array([0.3, 0.1, -0.1, 0.2, 0.1, 0.5])
    path = rrt_connect(problem.start, goal[None], free, np.random.default_rng(0))
    assert path_length(path) == pytest.approx(np.linalg.norm(goal - problem.start))


def test_without_a_way_there_is_none(pointer):
    """A pointer that does not turn all around, and a ball in its path."""
    robot = pointer(limit=2.0)
    ball = Obstacle(shape="sphere", position=(1.0, 0.0, 0.0), size=(0.05,) * 3)
    start, goals = np.array([-1.0]), np.array([[1.0]])
    rng = np.random.default_rng(0)
    assert rrt_connect(start, goals, EdgeChecker(robot, (ball,)), rng, iterations=500) is None
    assert rrt_connect(start, goals, EdgeChecker(robot, ()), rng, iterations=500) is not None
    same_side = np.array([[1.0], [-1.5]])
    path = rrt_connect(start, same_side, EdgeChecker(robot, (ball,)), rng)
    assert path[-1] == -1.5


def test_ends_that_are_not_free_lead_nowhere(problem, goals, checker):
    blocked = np.array([-1.57, 5.0, 1.0, 0.0, 2.6, 0.0])
    assert not checker.configurations_free(blocked[None])[0]
    rng = np.random.default_rng(0)
    assert rrt_connect(blocked, goals, checker, rng) is None
    assert rrt_connect(problem.start, blocked[None], checker, rng) is None
    assert rrt_connect(problem.start, np.empty((0, 6)), checker, rng) is None
    both = np.vstack([blocked, goals[:1]])
    np.testing.assert_array_equal(rrt_connect(problem.start, both, checker, rng)[-1], goals[0])


def test_ompl_solves_what_is_solved_here_and_finds_paths_of_like_length(problem, goals, checker):
    """The same start, goals, edges and step; OMPL differs in its random numbers and bookkeeping."""
    pytest.importorskip("ompl")
    from ompl import base, geometric, util

    util.setLogLevel(util.LOG_NONE)
    robot = checker.robot

    def configuration(state):
        return np.array([[state[i] for i in range(6)]])

    class Edges(base.MotionValidator):
        def checkMotion(self, first, second, last_valid=None):  # noqa: N802
            return bool(checker.edges_free(configuration(first), configuration(second))[0])

    space = base.RealVectorStateSpace(6)
    bounds = base.RealVectorBounds(6)
    turn = np.where(robot.upper - robot.lower > 2 * np.pi, np.pi, np.inf)
    for i in range(6):
        bounds.setLow(i, float(max(robot.lower[i], problem.start[i] - turn[i])))
        bounds.setHigh(i, float(min(robot.upper[i], problem.start[i] + turn[i])))
    space.setBounds(bounds)
    information = base.SpaceInformation(space)
    information.setStateValidityChecker(
        lambda state: bool(checker.configurations_free(configuration(state))[0])
    )
    edges = Edges(information)
    information.setMotionValidator(edges)
    information.setup()

    def state_of(q):
        state = space.allocState()
        for i in range(6):
            state[i] = float(q[i])
        return state

    lengths = []
    for _ in range(20):
        definition = base.ProblemDefinition(information)
        definition.addStartState(state_of(problem.start))
        ends = base.GoalStates(information)
        for goal in goals:
            ends.addState(state_of(goal))
        definition.setGoal(ends)
        oracle = geometric.RRTConnect(information)
        oracle.setRange(0.5)
        oracle.setProblemDefinition(definition)
        oracle.setup()
        assert oracle.solve(20.0)
        states = definition.getSolutionPath()
        path = [configuration(states.getState(k))[0] for k in range(states.getStateCount())]
        lengths.append(path_length(path))
    ours = [
        path_length(rrt_connect(problem.start, goals, checker, np.random.default_rng(seed)))
        for seed in range(20)
    ]
    assert 0.5 < np.median(ours) / np.median(lengths) < 2.0


def test_arguments_are_checked(problem, goals, checker):
    start, rng = problem.start, np.random.default_rng(0)
    with pytest.raises(ValueError, match="start"):
        rrt_connect(start[:5], goals, checker, rng)
    with pytest.raises(ValueError, match="start"):
        rrt_connect(np.full(6, np.nan), goals, checker, rng)
    with pytest.raises(ValueError, match="goals"):
        rrt_connect(start, goals[0], checker, rng)
    with pytest.raises(ValueError, match="iterations"):
        rrt_connect(start, goals, checker, rng, iterations=0)
    with pytest.raises(ValueError, match="step"):
        rrt_connect(start, goals, checker, rng, step=np.inf)
