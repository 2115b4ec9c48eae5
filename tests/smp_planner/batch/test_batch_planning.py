"""Plans of batches on the device "cpu": against those without a device, and what is refused."""

import dataclasses

import numpy as np
import pytest
import torch

from smp_planner.batch.check import path_gaps
from smp_planner.batch.plain_costs import plain_gaps
from smp_planner.batch.planning import DevicePlanner
from smp_planner.planners import make_planner
from smp_planner.planning.assessment import assess


@pytest.fixture(scope="module")
def plans(planner, problems):
    return planner.plan(problems, "cpu")


@pytest.fixture(scope="module")
def plain_plans(planner, problems):
    """The plans without a device."""
    return planner.plan(problems)


def test_plans_are_as_good_as_without_a_device(plans, plain_plans):
    # A rounding may cost one of the eight particles.
    assert sum(plan.good.sum() for plan in plans) >= sum(p.good.sum() for p in plain_plans) - 1
    for mine, other in zip(plans, plain_plans, strict=True):
        assert set(mine.costs) == set(other.costs)
        assert mine.weights.shape == other.weights.shape
        # Same draws, same directions: the two descend side by side.
        apart = np.abs(mine.trajectories - other.trajectories).mean()
        assert apart < 0.1 * np.abs(other.trajectories - other.trajectories.mean(0)).mean()


def test_the_check_is_the_exact_one(planner, problems, plans):
    for problem, plan in zip(problems, plans, strict=True):
        exact = assess(problem, plan.trajectories, planner.plan_settings)
        np.testing.assert_array_equal(plan.good, exact.good)
        np.testing.assert_allclose(plan.clearance, exact.clearance, atol=1.1e-3)
        np.testing.assert_allclose(plan.duration, exact.duration)


def test_the_check_looks_between_the_samples(planner, problems):
    """Three samples of a path that swings through the table: all but the ends are between them."""
    work = DevicePlanner.of("cpu")
    problem = problems[0]
    path = np.repeat(problem.start[None, None], 3, 1)
    path[0, 1:] += (0.0, 0.9, -0.9, 0.0, 0.0, 0.0)
    path[0, 2] += (0.0, -0.9, 0.9, 0.0, 0.0, 0.0)
    path = np.concatenate([path, np.repeat(problem.start[None, None], 3, 1)])
    tables = work.tables([problem], planner.plan_settings, 3)
    found = path_gaps(tables, tables.stages[0], torch.from_numpy(path).float()[None], plain_gaps)
    exact = assess(problem, path, planner.plan_settings)
    np.testing.assert_allclose(found.clearance[0], exact.clearance, atol=1.1e-3)


def test_a_batch_is_planned_as_its_problems_one_by_one(planner, problems, plans):
    # The two differ in spheres and obstacles, and are padded to one size in the batch.
    (alone,) = planner.plan([problems[1]], "cpu")
    np.testing.assert_allclose(alone.trajectories, plans[1].trajectories, atol=2e-3)
    np.testing.assert_array_equal(alone.good, plans[1].good)


def test_a_cost_of_ones_own_works_on_every_path(planner, problems, plans, plain_plans):
    def high(configurations):
        return (configurations[..., 1] - 3.0).square().mean(-1)

    for device, without in ((None, plain_plans[0]), ("cpu", plans[0])):
        (plan,) = planner.plan(problems[:1], device, own={"high": (3000.0, high)})
        assert plan.costs["high"].shape == (4,)
        before = high(torch.from_numpy(without.trajectories)).mean()
        assert plan.costs["high"].mean() < 0.7 * float(before)


def test_a_cost_of_ones_own_is_checked(planner, problems):
    with pytest.raises(ValueError, match="weight of cost 'x' must be positive, got -1"):
        planner.plan(problems, own={"x": (-1.0, torch.sum)})
    with pytest.raises(ValueError, match="must return a tensor of shape"):
        planner.plan(problems, "cpu", own={"x": (1.0, torch.sum)})


def test_conditioning_alone_can_be_planned_on_a_device(problems):
    planner = make_planner("promp", "Placement", settings={"particles": 4, "samples": 200})
    mine, other = planner.plan(problems, "cpu")[0], planner.plan(problems)[0]
    np.testing.assert_allclose(mine.trajectories, other.trajectories, atol=1e-9)
    np.testing.assert_array_equal(mine.good, other.good)


def test_a_device_that_does_not_exist_is_named(planner, problems):
    with pytest.raises(ValueError, match=r"device must be one of 'cpu'.*got 'cuda:99'"):
        planner.plan(problems, "cuda:99")
    with pytest.raises(ValueError, match="device must be 'cpu' or 'cuda', got 'gpu'"):
        planner.plan(problems, "gpu")


def test_an_empty_batch_has_no_plans(planner):
    assert planner.plan([]) == planner.plan([], "cpu") == []


def test_problems_of_different_robots_are_refused(planner, problems):
    first, second = problems
    model = dataclasses.replace(second.robot, velocity=2.0 * second.robot.velocity)
    body = dataclasses.replace(second.body, model=model)
    stage = dataclasses.replace(second.stages[0], body=body)
    other = dataclasses.replace(second, body=body, stages=(stage,))
    with pytest.raises(ValueError, match=r"must have one robot: problems\[1\] differs .* velocity"):
        planner.plan([first, other], "cpu")


def test_problems_of_different_tasks_are_refused(planner, problems):
    stage = dataclasses.replace(problems[1].stages[0], first=0.5)
    other = dataclasses.replace(problems[1], stages=(stage,))
    with pytest.raises(ValueError, match="problems of one batch must be of one task"):
        planner.plan([problems[0], other], "cpu")


def test_methods_and_settings_that_no_device_knows_are_refused(problems):
    with pytest.raises(ValueError, match="only the methods 'smp' and 'promp'"):
        make_planner("cpromp", "Placement").plan(problems, "cpu")
    early = {"early_stop": True, "inference": "quick"}
    for settings in (early, {"inference": "path_kernel"}, {"inference": "raw"}):
        with pytest.raises(ValueError, match="to plan on a device"):
            make_planner("smp", "Placement", settings=settings).plan(problems, "cpu")
