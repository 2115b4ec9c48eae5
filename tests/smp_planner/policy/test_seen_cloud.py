"""Plans made from what a depth camera sees: the map against the exact distance, and the physics."""

import gymnasium
import numpy as np
import pytest
from shipped_planners import planners_of

import smp_gym  # noqa: F401
from smp_gym.geometry.distance import signed_distance
from smp_gym.observation import decode
from smp_gym.robot.kinematics import finger_spheres
from smp_gym.scene import Obstacle
from smp_planner.collision.edge_check import EdgeChecker
from smp_planner.collision.robot_model import jaco_model
from smp_planner.collision.verification import check_collisions
from smp_planner.occupancy.point_cloud import closed_surface, layers_behind
from smp_planner.policy.observed_problem import seen_map
from smp_planner.policy.planner_policy import PlannerPolicy

BALL = Obstacle(shape="sphere", position=(0.4, 0.1, 0.4), size=(0.1, 0.1, 0.1))
TASK = "Placement"


@pytest.fixture(scope="module")
def env():
    env = gymnasium.make(f"smp_gym/{TASK}-v0", difficulty="easy", sensing="depth")
    yield env
    env.close()


def test_the_closed_surface_of_points_in_a_ball_is_the_ball():
    rng = np.random.default_rng(0)
    inside = rng.normal(size=(6000, 3))
    inside *= (0.1 * rng.uniform(size=(6000, 1)) ** (1 / 3)) / np.linalg.norm(
        inside, axis=1, keepdims=True
    )
    known = closed_surface(inside + np.array(BALL.position), 0.03)
    points = np.array(BALL.position) + rng.uniform(-0.2, 0.2, (2000, 3))
    true = signed_distance(points, [BALL])
    near = np.abs(true) < 0.08
    assert np.percentile(np.abs(known.signed_distance(points) - true)[near], 95) < 0.012


def test_layers_lie_behind_what_was_seen():
    seen, sensor = np.array([[1.0, 0.0, 0.0], [0.0, 2.0, 0.0]]), np.zeros(3)
    layers = layers_behind(seen, sensor, 0.05).reshape(-1, 2, 3)
    np.testing.assert_allclose(layers[0], seen)
    np.testing.assert_allclose(layers[-1], [[1.05, 0.0, 0.0], [0.0, 2.05, 0.0]])


def test_the_map_of_an_observation_is_that_of_the_seen_surfaces(env):
    for seed in range(3):
        observation, _ = env.reset(seed=seed)
        decoded = decode(observation, TASK)
        known = seen_map(decoded, finger_spheres(decoded.robot.finger_angles)).map
        error = known.signed_distance(decoded.points)
        assert np.percentile(np.abs(error), 95) < 0.015
        # Seen free space stays free: towards the camera nothing is added.
        towards = decoded.points + 0.08 * np.array([0.75, 0.15, 0.64])
        true = signed_distance(towards, env.unwrapped.scene.obstacles)
        clear = true > 0.06
        assert np.median((known.signed_distance(towards) - true)[clear]) > -0.02


def test_both_checks_see_the_cloud_alike(env):
    observation, _ = env.reset(seed=1)
    decoded = decode(observation, TASK)
    robot = jaco_model(finger_spheres(decoded.robot.finger_angles))
    grid = seen_map(decoded, finger_spheres(decoded.robot.finger_angles)).grid
    rng = np.random.default_rng(0)
    starts = decoded.robot.configuration + rng.normal(0.0, 0.5, (300, 6))
    ends = starts + rng.normal(0.0, 0.2, (300, 6))
    paths = np.stack([starts, ends], axis=1)
    by_edges = EdgeChecker(robot, (), grid=grid).edges_free(starts, ends)
    found = check_collisions(paths, robot, (), grid=grid)
    assert 0.05 < by_edges.mean() < 0.95
    # The search refuses what is free by less than twice the tolerance.
    assert not (by_edges & ~found.free).any()
    clear = found.free & (found.clearance > 0.005)
    alone = EdgeChecker(robot, ()).edges_free(starts, ends)
    assert by_edges[clear & alone].all()
    assert (by_edges < alone).any()


@pytest.mark.parametrize("method", planners_of(TASK))
def test_every_method_plans_on_the_cloud(env, method):
    observation, _ = env.reset(seed=2)
    settings = {"particles": 4} if method == "rrt_connect" else {"particles": 12}
    policy = PlannerPolicy.make(method, TASK, settings=settings)
    problem = policy.problem(observation)
    assert problem.cloud is not None
    assert problem.movable == ()
    (plan,) = policy.planner.plan([problem])
    # What the plan says of clearance is said of the map.
    found = check_collisions(
        plan.trajectories, problem.robot, problem.obstacles, grid=problem.cloud.grid
    )
    np.testing.assert_allclose(plan.clearance, found.clearance)


def test_smp_solves_easy_scenes_from_the_cloud_in_the_physics(env):
    policy = PlannerPolicy.make("smp", TASK)
    solved = 0
    for seed in range(4):
        observation, _ = env.reset(seed=seed)
        state, over = None, False
        while not over:
            action, state = policy.predict(observation, state, deterministic=True)
            observation, _, terminated, truncated, info = env.step(action)
            over = terminated or truncated
        solved += info["is_success"]
    assert solved >= 2
