"""Planning through via-points: the stroke of DrawS, from the observation to the physics."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import torch
from resampled_lines import piecewise_linear

from smp_gym.datasets.demonstrations import Demonstrations
from smp_gym.env import ManipulationEnv
from smp_gym.observation import decode
from smp_gym.robot.kinematics import PEN_TIP, UnreachableError
from smp_gym.robot.pen import pen_path
from smp_gym.sampling import place_without_witness, sample_scene
from smp_gym.scene import STROKE_POINTS, Obstacle
from smp_gym.tasks.draw_s.rules import RULES, equal_arc
from smp_planner.movement_primitives import ProMP
from smp_planner.planners import make_planner, task_settings
from smp_planner.planning.conditioning import condition, conditioned_parts
from smp_planner.planning.plan import Plan
from smp_planner.planning.settings import PlanSettings
from smp_planner.planning.tool_goals import ToolViaPoint
from smp_planner.policy.observed_problem import (
    CHECKPOINT_TOLERANCE,
    checkpoint_phases,
    problem_from,
)
from smp_planner.policy.planner_policy import PlannerPolicy


@pytest.fixture(scope="module")
def env():
    made = ManipulationEnv("DrawS", difficulty="easy")
    yield made
    made.close()


@pytest.fixture(scope="module")
def demonstrations():
    return Demonstrations.load("DrawS")


@pytest.fixture(scope="module")
def policy():
    return PlannerPolicy.make("smp", "DrawS")


@pytest.fixture(scope="module")
def problem(env, demonstrations):
    observation, _ = env.reset(options={"scene": sample_scene("DrawS", "easy", 4)})
    return problem_from(decode(observation, "DrawS"), 0, checkpoint_phases(demonstrations))


def primitive_with(seed=0, joints=2):
    rng = np.random.default_rng(seed)
    walk = np.cumsum(rng.normal(size=(5, 40, joints)), axis=1) / 6
    return ProMP.fit(walk), rng


@pytest.mark.parametrize("noise", [None, 0.3])
def test_observing_a_linear_function_agrees_with_the_dense_formula(noise):
    primitive, rng = primitive_with()
    rows = torch.from_numpy(rng.normal(size=(3, primitive.mean.shape[-1])))
    value = torch.from_numpy(rng.normal(size=3))
    variance = torch.zeros(3, dtype=torch.float64) if noise is None else torch.full((3,), noise**2)
    posterior = primitive.observe(rows, value, None if noise is None else variance)
    sigma = primitive.covariance
    gain = (
        sigma @ rows.mT @ torch.linalg.inv(rows @ sigma @ rows.mT + torch.diag(variance.double()))
    )
    mean = primitive.mean + gain @ (value - rows @ primitive.mean)
    torch.testing.assert_close(posterior.mean, mean)
    torch.testing.assert_close(
        posterior.covariance, sigma - gain @ rows @ sigma, atol=1e-6, rtol=1e-6
    )


@pytest.mark.parametrize(
    ("rows", "value", "message"),
    [
        (np.zeros((2, 3)), np.zeros(2), "rows must have shape"),
        (np.zeros((2, 30)), np.zeros(3), "value must have shape"),
        (np.full((2, 30), np.nan), np.zeros(2), "must be finite"),
        (np.zeros((1, 30)), np.ones(1), "contradicts what is certain"),
    ],
)
def test_bad_observations_are_errors(rows, value, message):
    primitive, _ = primitive_with()
    with pytest.raises(ValueError, match=message):
        primitive.observe(torch.from_numpy(rows), torch.from_numpy(value))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"phase": 1.2}, "phase must be .* at most 1.0, got 1.2"),
        ({"tolerance": 0.0}, "tolerance must be .* above 0.0, got 0.0"),
        ({"position": np.zeros(2)}, "position must have shape"),
        ({"point": np.full(3, np.inf)}, "point must be finite"),
    ],
)
def test_bad_via_points_are_named(changes, message):
    values = {"phase": 0.5, "point": np.zeros(3), "position": np.zeros(3), "tolerance": 0.01}
    with pytest.raises(ValueError, match=message):
        ToolViaPoint(**{**values, **changes})


def test_checkpoints_are_due_when_demonstrators_have_drawn_their_share(demonstrations):
    phases = checkpoint_phases(demonstrations)
    assert phases.shape == (STROKE_POINTS,)
    assert (np.diff(phases) > 0).all()
    assert (phases[0], phases[-1]) == (0.0, 1.0)
    pen = pen_path(demonstrations.configurations[3])
    due = np.rint(phases * 199).astype(int)
    lengths = [
        np.linalg.norm(np.diff(pen[a : b + 1], axis=0), axis=1).sum() for a, b in pairwise(due)
    ]
    # Equal but for the rounding to whole samples, each 1/6 of a part where the pen is fastest.
    assert np.std(lengths) < 0.2 * np.mean(lengths)


def test_the_problem_holds_what_the_goal_demands(problem):
    scene = sample_scene("DrawS", "easy", 4)
    stroke = scene.goals[0]
    wanted = [p for p, d in zip(stroke.checkpoints, stroke.demanded, strict=True) if d][1:-1]
    np.testing.assert_allclose([v.position for v in problem.via_points], wanted, atol=1e-6)
    assert (np.diff([v.phase for v in problem.via_points]) > 0).all()
    np.testing.assert_allclose(problem.goals[0].center, stroke.position, atol=1e-6)
    # Obstacles and table, but no bin.
    assert len(problem.obstacles) == len(scene.obstacles) + 1


def test_the_conditioned_mean_passes_the_via_points(policy, problem):
    (prior,) = policy.planner.prior.components()
    plain_constraints = [c for c in problem.constraints if c.name != "via_points"]
    through, plain = (
        condition(prior, constraints, PlanSettings())[0][0]
        for constraints in (problem.constraints, plain_constraints)
    )
    distances = []
    for primitive in (through, plain):
        at = torch.tensor([v.phase for v in problem.via_points], dtype=torch.float64)
        q = primitive.trajectory(primitive.mean, at).numpy()
        offset = pen_path(q) - [v.position for v in problem.via_points]
        distances.append(np.linalg.norm(offset, axis=1).max())
    assert distances[0] < CHECKPOINT_TOLERANCE
    assert distances[1] > 2 * distances[0]


def test_the_plan_passes_free_of_obstacles_and_the_control_does_not(policy, problem):
    plan = policy.planner.plan([problem])[0]
    assert plan.good[plan.chosen]
    pen = pen_path(plan.trajectories[plan.chosen])
    for via in problem.via_points:
        nearest = np.linalg.norm(pen - via.position, axis=1).min()
        assert nearest <= CHECKPOINT_TOLERANCE
    for particle, path in enumerate(pen_path(plan.trajectories)):
        worst = max(np.linalg.norm(path - v.position, axis=1).min() for v in problem.via_points)
        assert not (plan.passing[particle] and worst > CHECKPOINT_TOLERANCE)
    assert "via_points" in plan.costs
    control = make_planner("promp", "DrawS").plan([problem])[0]
    assert not control.good.any()
    assert "0 are collision-free" in control.message or "0 meet all" in control.message


def recorded(path):
    """A path as an episode records it, at `STROKE_POINTS` equal steps, the lines between cut."""
    points = piecewise_linear(path, STROKE_POINTS)
    fine = np.linspace(0, STROKE_POINTS - 1, 4 * (STROKE_POINTS - 1) + 1)
    return np.stack([np.interp(fine, np.arange(STROKE_POINTS), axis) for axis in points.T], axis=-1)


def test_a_plan_passes_what_its_recorded_stroke_passes(policy, env):
    scene = place_without_witness("DrawS", "hard", 92020)
    observation, _ = env.reset(options={"scene": scene})
    problem = policy.problem(observation)
    plan = policy.planner.plan([problem])[0]
    cut_corners = 0
    for passing, path in zip(plan.passing, pen_path(plan.trajectories), strict=True):
        worst = [
            max(np.linalg.norm(line - via.position, axis=1).min() for via in problem.via_points)
            for line in (path, recorded(path))
        ]
        assert passing == (worst[1] <= CHECKPOINT_TOLERANCE)
        cut_corners += worst[0] <= CHECKPOINT_TOLERANCE < worst[1]
    assert cut_corners
    stroke = equal_arc(pen_path(plan.trajectories[plan.chosen])).ravel()
    achieved = np.concatenate([stroke, np.ones(STROKE_POINTS), [0.0]])
    assert plan.good[plan.chosen]
    assert RULES.success(achieved, observation["desired_goal"])


@pytest.mark.parametrize("seed", range(3))
def test_the_policy_draws_the_s_in_the_physics(policy, env, seed):
    observation, info = env.reset(seed=seed)
    state, done = None, False
    for _ in range(400):
        action, state = policy.predict(observation, state, deterministic=True)
        observation, _, done, _, info = env.step(action)
        if done:
            break
    assert info["is_success"], info


def test_settings_of_a_task_give_way_to_those_that_are_given():
    assert task_settings("smp", "DrawS")["smooth_std"] == 0.4
    assert make_planner("smp", "DrawS").settings["smooth_std"] == 0.4
    assert make_planner("smp", "Placement").settings["smooth_std"] == 0.2
    made = make_planner("smp", "DrawS", settings={"smooth_std": 0.3})
    assert (made.settings["smooth_std"], made.settings["via_share"]) == (0.3, 0.25)


@pytest.mark.parametrize(("functions", "length_scale"), [(15, 0.2), (25, 0.1)])
def test_what_is_added_bends_as_sharply_as_its_length_scale_says(functions, length_scale):
    settings = {"basis_functions": functions, "smooth_length_scale": length_scale}
    narrow, wide = (
        make_planner("promp", "DrawS", settings={**settings, "smooth_std": std}).prior.single
        for std in (0.3, 0.5)
    )
    # The learned part is in both. A convolution with the bump adds its variance at either end.
    place = (wide.marginal(0.5)[1] - narrow.marginal(0.5)[1]).diagonal()
    slope = wide.marginal(0.5, derivative=True)[1] - narrow.marginal(0.5, derivative=True)[1]
    bends = np.sqrt(length_scale**2 + 2.0 / (functions - 3) ** 2)
    np.testing.assert_allclose(place, 0.5**2 - 0.3**2, rtol=1e-6)
    np.testing.assert_allclose((place / slope.diagonal()).sqrt(), bends, rtol=0.02)


def test_widening_a_primitive_equals_learning_it_wider(problem):
    settings = {"smooth_length_scale": 0.1, "basis_functions": 25}
    narrow, wide = (
        make_planner("promp", "DrawS", settings={**settings, "smooth_std": std})
        for std in (0.2, 0.4)
    )
    widened, learned = (
        condition(planner.prior.components(width)[0], problem.constraints, PlanSettings())[0][0]
        for planner, width in ((narrow, 2.0), (wide, 1.0))
    )
    torch.testing.assert_close(widened.covariance, learned.covariance, rtol=0.0, atol=1e-8)
    torch.testing.assert_close(widened.mean, learned.mean, rtol=0.0, atol=1e-6)


def test_bends_between_checkpoints_and_obstacles_need_the_finer_basis(env):
    scene = place_without_witness("DrawS", "medium", 20002)
    observation, _ = env.reset(options={"scene": scene})
    coarse = {"retries": 0, "basis_functions": 15, "smooth_length_scale": 0.2}
    good = []
    for settings in ({"retries": 0}, coarse):
        policy = PlannerPolicy.make("smp", "DrawS", settings=settings)
        good.append(policy.predict(observation)[1][0].plan.good.mean())
    assert good[0] >= 0.3
    assert good[1] == 0.0


def test_a_retry_so_wide_that_it_misses_the_goal_ends_the_tries(env, demonstrations):
    scene = sample_scene("DrawS", "easy", 3)
    x, y, z = scene.goals[0].position
    wall = Obstacle(shape="box", position=(x, y, z + 0.1), size=(0.06, 0.06, 0.1))
    observation, _ = env.reset(options={"scene": scene.model_copy(update={"obstacles": (wall,)})})
    problem = problem_from(decode(observation, "DrawS"), 0, checkpoint_phases(demonstrations))
    stiff = {"basis_functions": 15, "smooth_length_scale": 0.2}
    quick = {"inference": "quick", "iterations": 2, "particles": 4, "retries": 7}
    planner = make_planner("smp", "DrawS", settings={**stiff, **quick})
    with pytest.raises(UnreachableError):
        conditioned_parts(planner.prior, problem, planner.plan_settings, 2.0**7)
    (plan,) = planner.plan([problem])
    assert not plan.good.any()


def test_only_particles_that_pass_are_good():
    flags = np.array([True, True])
    zeros = np.zeros(2)
    plan = Plan(
        trajectories=np.zeros((2, 4, 6)),
        costs={},
        collision_free=flags,
        clearance=zeros,
        missed={},
        passing=flags,
        duration=zeros,
        executable=flags,
        ranks=np.arange(2),
        signatures=np.zeros((2, 1), np.int64),
    )
    assert plan.good.tolist() == [True, True]
    assert replace(plan, passing=np.array([True, False])).good.tolist() == [True, False]


def test_via_points_are_carried_by_the_pen(problem):
    for via in problem.via_points:
        np.testing.assert_array_equal(via.point, PEN_TIP)
