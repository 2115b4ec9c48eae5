"""Against dense sampling in numpy, the exact check, and OMPL's RRT-Connect."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from smp_gym.demonstrations import Demonstrations
from smp_gym.kinematics import (
    SphereSet,
    UnreachableError,
    arm_spheres,
    box_spheres,
    concatenate,
    end_effector_pose,
    finger_spheres,
    sphere_centers,
)
from smp_gym.sampling import sample_scene
from smp_gym.scene import BIN_HEIGHT, Obstacle, fixtures
from smp_planner.edge_check import EdgeChecker
from smp_planner.movement_primitives import GaussianBasis, phases
from smp_planner.occupancy.analytic import signed_distance
from smp_planner.planners import make_planner
from smp_planner.planners.rrt_connect import (
    RRTConnectSettings,
    goal_postures,
    rrt_connect,
    solve,
)
from smp_planner.problem import GoalRegion, Problem
from smp_planner.robot_model import RobotModel, jaco_model
from smp_planner.shortcutting import path_length
from smp_planner.verification import check_collisions, verify

HELD = np.eye(4)
HELD[0, 3] = 0.022
POSTURES = np.array([path[-1] for path in Demonstrations.load("Placement").configurations])


def region(center, half=(0.02, 0.02, 0.015)):
    return GoalRegion(HELD[:3, 3], np.subtract(center, half), np.add(center, half))


def problem_of(scene, seed=0, extra=(), goals=None):
    spheres = concatenate(
        finger_spheres((0.9, 0.9, 0.3, 0.3)), box_spheres((0.025, 0.025, 0.03), HELD)
    )
    if goals is None:
        x, y, z = scene.goals[0].position
        goals = (region((x, y, z + BIN_HEIGHT + 0.055)),)
    obstacles = (*scene.obstacles, *extra, *fixtures(scene))
    return Problem(np.array(scene.start), obstacles, spheres, goals, seed)


def free_goals(problem, checker, count=64):
    rng = np.random.default_rng(0)
    goals = goal_postures(problem, checker.robot, POSTURES, rng, count=count)
    return goals[checker.configurations_free(goals)]


def lid(scene):
    """A plate over the bin, under which no hand fits."""
    x, y, _ = scene.goals[0].position
    return Obstacle(shape="box", position=(x, y, 0.2), size=(0.2, 0.2, 0.05))


@pytest.fixture(scope="module")
def scene():
    return sample_scene("Placement", "hard", 3)


@pytest.fixture(scope="module")
def checker(scene):
    problem = problem_of(scene)
    return EdgeChecker(jaco_model(problem.attached), problem.obstacles, 0.005)


@pytest.fixture(scope="module")
def planner():
    return make_planner("rrt_connect", "Placement")


@pytest.fixture(scope="module")
def plan(planner, scene):
    return planner.plan([problem_of(scene)])[0]


def test_a_path_is_free_from_start_to_goal(scene, checker):
    """Sampled finely, with nothing of the planner's own checker."""
    problem = problem_of(scene)
    goals = free_goals(problem, checker)
    assert not checker.edges_free(np.tile(problem.start, (len(goals), 1)), goals).any()
    path = rrt_connect(problem.start, goals, checker, np.random.default_rng(0))
    np.testing.assert_array_equal(path[0], problem.start)
    assert (path[-1] == goals).all(axis=1).any()
    assert np.linalg.norm(np.diff(path, axis=0), axis=1).max() <= 0.5 + 1e-9
    spheres = concatenate(arm_spheres(), problem.attached)
    moving = spheres.link > 0
    for a, b in pairwise(path):
        fine = np.linspace(a, b, 100)
        centers = sphere_centers(fine, spheres)[:, moving]
        assert (signed_distance(centers, problem.obstacles) - spheres.radius[moving]).min() >= 0.005


def test_in_free_space_the_way_is_straight(scene):
    problem = problem_of(scene)
    free = EdgeChecker(jaco_model(problem.attached), ())
    goal = problem.start + np.array([0.3, 0.1, -0.1, 0.2, 0.1, 0.5])
    path = rrt_connect(problem.start, goal[None], free, np.random.default_rng(0))
    assert path_length(path) == pytest.approx(np.linalg.norm(goal - problem.start))


def test_without_a_way_there_is_none():
    """A pointer with one joint that does not turn all around, and a ball in its way."""
    pointer = RobotModel(
        base=np.eye(4),
        joint_origins=np.eye(4)[None],
        end_effector=np.eye(4),
        lower=np.array([-2.0]),
        upper=np.array([2.0]),
        velocity=np.array([1.0]),
        spheres=SphereSet(np.array([1]), np.array([[1.0, 0.0, 0.0]]), np.array([0.1])),
        collision_pairs=np.empty((0, 2), np.int64),
    )
    ball = Obstacle(shape="sphere", position=(1.0, 0.0, 0.0), size=(0.05,) * 3)
    start, goals = np.array([-1.0]), np.array([[1.0]])
    rng = np.random.default_rng(0)
    assert rrt_connect(start, goals, EdgeChecker(pointer, (ball,)), rng, iterations=500) is None
    assert rrt_connect(start, goals, EdgeChecker(pointer, ()), rng, iterations=500) is not None
    same_side = np.array([[1.0], [-1.5]])
    path = rrt_connect(start, same_side, EdgeChecker(pointer, (ball,)), rng)
    assert path[-1] == -1.5


def test_ends_that_are_not_free_lead_nowhere(scene, checker):
    problem = problem_of(scene)
    goals = free_goals(problem, checker)
    blocked = np.array([-1.57, 5.0, 1.0, 0.0, 2.6, 0.0])
    assert not checker.configurations_free(blocked[None])[0]
    rng = np.random.default_rng(0)
    assert rrt_connect(blocked, goals, checker, rng) is None
    assert rrt_connect(problem.start, blocked[None], checker, rng) is None
    assert rrt_connect(problem.start, np.empty((0, 6)), checker, rng) is None
    both = np.vstack([blocked, goals[:1]])
    np.testing.assert_array_equal(rrt_connect(problem.start, both, checker, rng)[-1], goals[0])


def test_ompl_solves_what_is_solved_here_and_finds_paths_of_like_length(scene, checker):
    """The same start, goals, edges and step; OMPL differs in its random numbers and bookkeeping."""
    pytest.importorskip("ompl")
    from ompl import base, geometric, util

    util.setLogLevel(util.LOG_NONE)
    problem = problem_of(scene)
    goals = free_goals(problem, checker, count=8)
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


def test_goal_postures_reach_the_goals(scene, checker):
    x, y, z = scene.goals[0].position
    here, there = region((x, y, z + 0.2)), region((x + 0.1, y + 0.1, z + 0.25))
    problem = problem_of(scene, goals=(here, there))
    rng = np.random.default_rng(0)
    turned = POSTURES + np.array([2 * np.pi, 0, 0, 0, 0, 0])
    postures = goal_postures(problem, checker.robot, turned, rng)
    assert len(postures) > 50
    points = (end_effector_pose(postures) @ HELD)[:, :3, 3]
    inside = [((points >= g.lower) & (points <= g.upper)).all(axis=1) for g in (here, there)]
    assert (inside[0] | inside[1]).all()
    assert inside[0].sum() > 20
    assert inside[1].sum() > 20
    assert (postures >= checker.robot.lower).all()
    assert (postures <= checker.robot.upper).all()
    assert (np.abs(postures - problem.start)[:, [0, 3, 5]] <= np.pi + 1e-9).all()


def test_fewer_postures_than_goals_are_no_error(scene, checker):
    goals = (region((-0.1, -0.5, 0.3)), region((0.1, -0.5, 0.3)))
    problem = problem_of(scene, goals=goals)
    assert len(goal_postures(problem, checker.robot, POSTURES, np.random.default_rng(0), count=1))


@pytest.mark.parametrize("difficulty", ["none", "easy", "medium", "hard"])
def test_scenes_are_solved(difficulty):
    for seed in range(12):
        problem = problem_of(sample_scene("Placement", difficulty, seed), seed)
        trajectory = solve(problem, POSTURES)
        robot = jaco_model(problem.attached)
        verdict = verify(trajectory[None], robot, problem.obstacles)
        assert verdict.collision_free[0]
        assert verdict.executable[0]
        assert verdict.clearance[0] >= 0.005
        np.testing.assert_array_equal(trajectory[0], problem.start)
        end = (end_effector_pose(trajectory[-1]) @ HELD)[:3, 3]
        assert (end >= problem.goals[0].lower).all()
        assert (end <= problem.goals[0].upper).all()


def test_what_cannot_be_solved_has_no_solution(scene):
    assert solve(problem_of(scene, extra=(lid(scene),)), POSTURES) is None


def test_a_start_nearer_than_the_margin_is_left_with_the_least_one(scene):
    problem = problem_of(scene)
    robot = jaco_model(problem.attached)
    still = np.stack([problem.start, problem.start])[None]
    held = (end_effector_pose(problem.start) @ HELD)[:3, 3]
    # A post beside the held object, as near as the clearance that is asked for below.
    for distance in np.arange(0.05, 0.4, 5e-4):
        post = Obstacle(
            shape="sphere", position=(held[0] + distance, held[1], held[2]), size=(0.01,) * 3
        )
        if check_collisions(still, robot, (post,)).clearance[0] > 0.003:
            break
    near = replace(problem, obstacles=(*problem.obstacles, post))
    assert not EdgeChecker(robot, (post,), 0.005).configurations_free(problem.start[None])[0]
    trajectory = solve(near, POSTURES)
    check = check_collisions(trajectory[None], robot, near.obstacles)
    assert check.free[0]
    assert check.clearance[0] < 0.005


def test_a_plan_is_a_set_of_different_good_trajectories(plan, scene):
    assert plan.trajectories.shape == (4, 200, 6)
    assert plan.weights.shape == (4, 15, 6)
    assert plan.good.all()
    assert plan.message == ""
    assert (plan.goal_error == 0.0).all()
    np.testing.assert_array_equal(plan.trajectories[:, 0], np.tile(scene.start, (4, 1)))
    for i in range(4):
        for j in range(i):
            assert np.abs(plan.trajectories[i] - plan.trajectories[j]).max() > 0.05
    speed = np.abs(np.diff(plan.trajectories, axis=1))
    assert (speed[:, [0, -1]].max(axis=(1, 2)) < 0.02 * speed.max(axis=(1, 2))).all()


def test_weights_are_those_of_least_squares(plan):
    basis = GaussianBasis().values(phases(200)).numpy()
    for weights, trajectory in zip(plan.weights, plan.trajectories, strict=True):
        nearest = np.linalg.lstsq(basis, trajectory, rcond=None)[0]
        np.testing.assert_allclose(weights, nearest, atol=1e-8)


def test_the_same_problem_gives_the_same_plan_whatever_came_before(planner, plan, scene):
    other = problem_of(sample_scene("Placement", "easy", 5), seed=9)
    np.random.default_rng().random(3)
    again = planner.plan([other, problem_of(scene)])[1]
    np.testing.assert_array_equal(again.trajectories, plan.trajectories)
    np.testing.assert_array_equal(again.weights, plan.weights)
    assert again.chosen == plan.chosen
    different = planner.plan([problem_of(scene, seed=1)])[0]
    assert not np.array_equal(different.trajectories, plan.trajectories)


def test_fewer_particles_are_the_first_of_more(plan, scene):
    two = make_planner("rrt_connect", "Placement", settings={"particles": 2})
    few = two.plan([problem_of(scene)])[0]
    np.testing.assert_array_equal(few.trajectories, plan.trajectories[:2])


def test_a_scene_without_a_way_is_said_to_have_none(planner, scene):
    plan = planner.plan([problem_of(scene, extra=(lid(scene),))])[0]
    assert not plan.good.any()
    assert "0 of 64 configurations" in plan.message
    assert plan.trajectories.shape == (4, 200, 6)
    assert plan.clearance[plan.chosen] < 0


def test_a_search_that_gives_up_is_told_from_one_without_goals(scene):
    hasty = make_planner("rrt_connect", "Placement", settings={"iterations": 1, "particles": 2})
    plan = hasty.plan([problem_of(scene)])[0]
    assert not plan.good.any()
    assert "0 of 2 searches" in plan.message
    assert "0 of 64 configurations" not in plan.message


def test_a_goal_out_of_reach_is_named(planner, scene):
    with pytest.raises(UnreachableError, match=r"2\.5"):
        planner.plan([problem_of(scene, goals=(region((2.5, 0.0, 0.3)),))])


@pytest.mark.parametrize(
    "settings",
    [
        {"margin": 0.0},
        {"iterations": 0},
        {"step": 0.0},
        {"postures": 0},
        {"posture_spread": -1.0},
        {"shortcuts": -1},
        {"margin": float("nan")},
    ],
)
def test_settings_are_checked(settings):
    with pytest.raises(ValueError, match=next(iter(settings))):
        RRTConnectSettings.model_validate(settings)


def test_arguments_are_checked(scene, checker):
    start, goals, rng = np.array(scene.start), POSTURES, np.random.default_rng(0)
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
    for postures in (POSTURES[0], POSTURES[:0], np.full((1, 6), np.nan)):
        with pytest.raises(ValueError, match="postures"):
            solve(problem_of(scene), postures)
