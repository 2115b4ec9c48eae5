"""The paper's baselines: what each must do whatever the scene, and what it is worth in one."""

from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch

from smp_gym.observation import decode
from smp_gym.scene import Obstacle
from smp_planner.adaptation.variational import VariationalSettings
from smp_planner.planners import make_planner
from smp_planner.planning.conditioning import condition
from smp_planner.planning.settings import PlanSettings
from smp_planner.planning.tool_constraints import Reaching
from smp_planner.policy.observed_problem import problem_from

BASELINES = ("cpromp", "prompt_o", "promp_diff")
SHIFTING = BASELINES[1:]
SEEDS = (0, 1, 2)
SAME: dict[str, Any] = {"basis_functions": 15, "smooth_length_scale": 0.2, "widths": (1.0,)}
"""The control's primitive, so that draws can be compared one by one."""


@pytest.fixture(scope="module")
def problems(placement, blocked):
    return [placement(blocked(seed), seed=seed) for seed in SEEDS]


@pytest.fixture(scope="module")
def plans(problems):
    """The plans of all baselines and of the control, without a second try."""
    plans = {
        name: make_planner(name, "Placement", settings={"retries": 0, **SAME}).plan(problems)
        for name in BASELINES
    }
    return plans | {"promp": make_planner("promp", "Placement").plan(problems)}


@pytest.mark.parametrize("name", BASELINES)
def test_a_plan_is_whole_and_begins_at_rest_in_the_present_configuration(name, plans, problems):
    for plan, problem in zip(plans[name], problems, strict=True):
        assert plan.weights.shape == (42, 15, 6)
        assert plan.trajectories.shape == (42, 200, 6)
        start = np.tile(problem.start, (42, 1))
        np.testing.assert_allclose(plan.trajectories[:, 0], start, atol=1e-9)
        speed = np.abs(np.diff(plan.trajectories, axis=1))
        assert (speed[:, [0, -1]].max(axis=(1, 2)) < 0.1 * speed.max(axis=(1, 2))).all()
        assert set(plan.timings) == {"map", "conditioning", "inference", "verification"}
        assert all(np.isfinite(cost).all() for cost in plan.costs.values())


@pytest.mark.parametrize(("name", "share"), [("cpromp", 0.8), ("prompt_o", 0.3)])
def test_most_particles_are_freed(name, share, plans):
    free = np.mean([plan.collision_free for plan in plans[name]])
    assert free > share > 5 * np.mean([plan.collision_free for plan in plans["promp"]])


@pytest.mark.parametrize("name", BASELINES)
def test_good_particles_are_found_where_hardly_a_plain_draw_is_good(name, plans):
    assert np.mean([control.good for control in plans["promp"]]) < 0.02
    solved = [bool(plan.good[plan.chosen]) for plan in plans[name]]
    assert sum(solved) >= len(SEEDS) - 1
    freed, unadapted = (np.mean([p.collision_free for p in plans[n]]) for n in (name, "promp"))
    assert freed > unadapted + 0.02


def among(problem, obstacles, goals):
    """Return the problem with other obstacles and goals."""
    (stage,) = problem.stages
    reaching = Reaching(goals, problem.robot)
    return replace(
        problem,
        stages=(replace(stage, obstacles=obstacles),),
        constraints=(*problem.constraints[:-1], reaching),
        seed=5,
    )


def latents(name, plan, problem):
    """Return the standard normals (P, r) that a plan's weights are under the control's prior."""
    control = make_planner("promp", "Placement")
    (prior,) = control.prior.components()
    primitive = condition(prior, problem.constraints, PlanSettings())[0][0]
    return primitive.whiten(torch.from_numpy(plan.weights.reshape(len(plan.weights), -1))).numpy()


def test_cpromp_gives_up_spread_for_freedom(plans, problems):
    """By its defaults, which belong to no task."""
    usual = {name: field.default for name, field in VariationalSettings.model_fields.items()}
    costs = {"obstacle_weight": 3.0, "margin": 0.01, "edge_width": (0.05, 0.01), "retries": 0}
    freed = make_planner("cpromp", "Placement", settings=SAME | usual | costs).plan(problems)
    spreads = []
    for plan, control, problem in zip(freed, plans["promp"], problems, strict=True):
        sets = (latents(name, p, problem) for name, p in (("c", plan), ("p", control)))
        spreads.append([each.std(axis=0).mean() for each in sets])
    narrow, wide = np.mean(spreads, axis=0)
    assert 0.2 < narrow < 0.99 * wide


@pytest.mark.parametrize("name", SHIFTING)
def test_the_covariance_stays_and_the_mean_moves(name, plans):
    for plan, control in zip(plans[name], plans["promp"], strict=True):
        shift = plan.weights - control.weights
        np.testing.assert_allclose(shift, np.broadcast_to(shift[:1], shift.shape), atol=1e-9)
        assert np.abs(shift).max() > 0.02


@pytest.mark.parametrize("name", [*BASELINES, "cpromp_chance"])
def test_with_nothing_to_avoid_the_primitive_stays_as_it_is(name, problems, region):
    """No obstacle within reach, a wide goal, no other cost: the control's draws come out again."""
    problem = problems[0]
    far = Obstacle(shape="sphere", position=(3.0, 3.0, 3.0), size=(0.05, 0.05, 0.05))
    goal = region(problem.goals[0].center, half=(0.2, 0.2, 0.2))
    free = among(problem, (far,), (goal,))
    nothing_else = SAME | {
        "self_collision_weight": 0.0,
        "velocity_weight": 0.0,
        "limit_weight": 0.0,
    }
    (plan,) = make_planner(name, "Placement", settings=nothing_else).plan([free])
    (control,) = make_planner("promp", "Placement").plan([free])
    np.testing.assert_allclose(plan.weights, control.weights, atol=1e-9)
    assert plan.chosen == control.chosen


def test_cpromp_without_obstacles_is_nearly_the_prior(problems):
    """Its other costs, at their usual weights, take little from draws whose path is free."""
    problem = problems[0]
    free = among(problem, (), problem.goals)
    (plan,) = make_planner("cpromp", "Placement", settings={"particles": 1000, **SAME}).plan([free])
    drawn = latents("cpromp", plan, free)
    assert np.linalg.norm(drawn.mean(axis=0)) < 1.5
    assert np.cov(drawn.T).trace() / drawn.shape[1] == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize("name", BASELINES)
def test_the_same_problem_gives_the_same_plan_whatever_came_before(name, problems):
    planner = make_planner(name, "Placement", settings={"retries": 0, "iterations": 3})
    (plan,) = planner.plan(problems[1:2])
    again = planner.plan(problems[:2])[1]
    np.testing.assert_array_equal(again.trajectories, plan.trajectories)
    assert again.chosen == plan.chosen
    (different,) = planner.plan([replace(problems[1], seed=77)])
    assert not np.array_equal(different.trajectories, plan.trajectories)


@pytest.mark.parametrize("seed", [60000, 60001, 60002])
def test_chance_constraints_find_good_particles_in_easy_scenes(seed):
    env = gymnasium.make("smp_gym/Placement-v0", difficulty="easy")
    observation, _ = env.reset(seed=seed)
    env.close()
    problem = problem_from(decode(observation, "Placement"), seed=seed)
    (plan,) = make_planner("cpromp_chance", "Placement").plan([problem])
    assert plan.good.any()
    assert plan.good[plan.chosen]


@pytest.fixture(scope="module")
def two_sided():
    env = gymnasium.make("smp_gym/DoubleSidedPlacement-v0", difficulty="easy")
    observation, _ = env.reset(seed=1)
    env.close()
    return problem_from(decode(observation, "DoubleSidedPlacement"), seed=0)


@pytest.mark.parametrize("name", BASELINES)
def test_components_are_adapted_on_their_own_or_merged(name, two_sided):
    quick = {"retries": 0, "planning_steps": 20, "iterations": 5}
    each = make_planner(name, "DoubleSidedPlacement", settings=quick)
    (plan,) = each.plan([two_sided])
    assert [int((plan.components == c).sum()) for c in (0, 1)] == [21, 21]
    merged = make_planner(name, "DoubleSidedPlacement", settings={**quick, "per_component": False})
    (single,) = merged.plan([two_sided])
    assert single.components is None
    assert len(merged.prior.used.components) == 1
    # A component ends where its demonstrations did; one Gaussian is tied to the likelier of both.
    robot = two_sided.robot
    sides = []
    for planned in (plan, single):
        ends = planned.trajectories[:, -1]
        away = [
            np.linalg.norm(robot.carried_points(ends, goal.point)[0] - goal.center, axis=1)
            for goal in two_sided.goals
        ]
        sides.append(np.argmin(away, axis=0))
    np.testing.assert_array_equal(sides[0], plan.components)
    assert len(set(sides[1])) == 1


@pytest.mark.parametrize(
    ("name", "settings"),
    [
        ("cpromp", {"iterations": 0}),
        ("cpromp", {"step_size": 0.0}),
        ("cpromp", {"draws": 0}),
        ("cpromp", {"per_component": "both"}),
        ("cpromp_chance", {"risk": 0.0}),
        ("cpromp_chance", {"risk": 0.5}),
        ("cpromp_chance", {"rounds": 0}),
        ("cpromp_chance", {"draws": 0}),
        ("cpromp_chance", {"growth": 0.9}),
        ("cpromp_chance", {"decay": 0.0}),
        ("prompt_o", {"rounds": 0}),
        ("prompt_o", {"iterations": 0}),
        ("prompt_o", {"step_size": -1.0}),
        ("prompt_o", {"pairs": 0}),
        ("promp_diff", {"iterations": 0}),
        ("promp_diff", {"flow_time": 0.0}),
        ("promp_diff", {"longest_move": -0.1}),
        ("promp_diff", {"fit_std": 0.0}),
        ("promp_diff", {"taper": 0.6}),
        ("promp_diff", {"taper": 0.0}),
        ("promp_diff", {"inference": "paper"}),
    ],
)
def test_settings_are_checked(name, settings):
    with pytest.raises(ValueError, match=next(iter(settings))):
        make_planner(name, "Placement", settings=settings)
