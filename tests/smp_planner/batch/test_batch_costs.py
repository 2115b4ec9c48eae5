"""Gradients of the batch's costs against autograd, values against the compiled costs."""

import dataclasses

import numpy as np
import pytest
import torch
from batch_problems import ROUND

from smp_gym.geometry.distance import PackedObstacles, signed_distance_and_gradient
from smp_gym.scene import TABLE
from smp_planner.batch.plain_costs import PlainCosts, obstacle_distance, plain_gaps
from smp_planner.batch.problem_tables import Tables, obstacle_rows
from smp_planner.collision.verification import check_collisions
from smp_planner.planning.target import SceneTarget

CPU = torch.device("cpu")


@pytest.fixture(scope="module")
def settings(planner):
    return planner.plan_settings.model_copy(update={"planning_steps": 20})


@pytest.fixture(scope="module")
def tables(problems, settings):
    return Tables.of(problems, settings, CPU, torch.float64)


@pytest.mark.parametrize("width", [0.05, 0.01])
def test_gradient_is_that_of_autograd(tables, paths, width):
    given = paths.clone().requires_grad_()
    value, gradient = PlainCosts(tables).weighted(given, width)
    (expected,) = torch.autograd.grad(value.sum(), given)
    assert float(expected.abs().max()) > 1.0
    torch.testing.assert_close(gradient, expected, rtol=1e-9, atol=1e-8)


def test_each_cost_has_something_to_say_on_the_paths_of_the_tests(tables, paths):
    costs = PlainCosts(tables).costs(paths)
    assert set(costs) == {"obstacles", "self_collision", "velocity", "joint_limits", "goal"}
    for name, value in costs.items():
        assert float(value.max()) > 1e-3, name


def test_single_precision_is_enough(tables, paths):
    exact = PlainCosts(tables).gradient(paths, 0.01)
    single = PlainCosts(tables.to(CPU, torch.float32)).gradient(paths.float(), 0.01)
    assert float((single - exact).norm() / exact.norm()) < 1e-4


def test_costs_are_those_of_planning_without_a_device(tables, problems, settings, paths):
    """In double precision here, in single there; obstacles exactly here, on a 15 mm grid there."""
    found = PlainCosts(tables).costs(paths)
    gradients = PlainCosts(tables).gradient(paths, settings.edge_width[1])
    for b, problem in enumerate(problems):
        target = SceneTarget(problem, settings)
        for name, expected in target.costs(paths[b].numpy()).items():
            tolerance = 0.05 if name == "obstacles" else 3e-4
            np.testing.assert_allclose(
                found[name][b], expected, rtol=tolerance, atol=tolerance, err_msg=name
            )
        expected = target.gradient(paths[b].numpy(), 1.0)
        difference = np.linalg.norm(gradients[b].numpy() - expected)
        assert difference < 0.1 * np.linalg.norm(expected)


def test_distance_is_that_of_the_geometry(tables):
    obstacles = (TABLE, *ROUND)
    rng = np.random.default_rng(0)
    points = rng.uniform((-0.6, -0.6, -0.1), (0.8, 0.8, 0.8), (500, 3))
    distance, gradient = signed_distance_and_gradient(points, PackedObstacles.of(obstacles))
    stage = tables.stages[0]
    rows = torch.from_numpy(obstacle_rows(obstacles))[None]
    stage = dataclasses.replace(
        stage, obstacles=rows, obstacle_count=torch.tensor([len(obstacles)])
    )
    found, slope = obstacle_distance(torch.from_numpy(points)[None], stage)
    np.testing.assert_allclose(found[0], distance, atol=1e-12)
    np.testing.assert_allclose(slope[0], gradient, atol=1e-12)


def test_gaps_at_configurations_are_those_of_the_exact_check(problems, settings, paths):
    """A path that stands still has the clearance of its configuration."""
    tables = Tables.of(problems, settings, CPU, torch.float64, 2)
    for b, problem in enumerate(problems):
        still = paths[b, :, :1].expand(-1, 2, -1)
        mine = tables.of_problems([b])
        gap, own = plain_gaps(mine, mine.stages[0], still[None])
        exact = check_collisions(still.numpy(), problem.robot, problem.obstacles)
        np.testing.assert_allclose(gap[0, :, 0], exact.clearance, atol=1e-9)
        np.testing.assert_array_equal(own[0, :, 0] >= 1e-3, exact.self_free)
