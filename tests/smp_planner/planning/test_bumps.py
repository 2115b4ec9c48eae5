"""Bumps on the conditioned mean, against the primitive's own conditioning."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from smp_gym.sampling import sample_scene
from smp_planner.agents.posed_scenes import posed, primitive_of
from smp_planner.planning.assessment import assess
from smp_planner.planning.bumps import SoftenedCheck, bump_phases, bumped_mean, scale_of


@pytest.fixture(scope="module", params=["Placement", "DrawS"])
def bumped(request):
    (problem,) = posed([sample_scene(request.param, "easy", 3)])
    planner = primitive_of(request.param)
    (prior,) = planner.prior.components()
    found = bumped_mean(prior, problem, planner.plan_settings, bump_phases(5))
    return prior, found, planner.plan_settings


def test_a_bump_is_how_the_primitive_changes_when_a_joint_is_seen_elsewhere(bumped):
    prior, found, _ = bumped
    posterior = found.posterior
    for number, phase in enumerate(bump_phases(5)):
        at = prior.basis.values(torch.tensor(phase))
        for joint in (0, 4):
            rows = torch.zeros(1, prior.basis.count, 6, dtype=torch.float64)
            rows[0, :, joint] = at
            rows = rows.flatten(1)
            value = rows @ posterior.mean + 0.1
            moved = posterior.observe(rows, value).mean - posterior.mean
            bump = found.changes[6 * number + joint]
            # Both lie along one line; the bump is scaled by what the primitive is free to do.
            share = (rows @ posterior.factor).square().sum() / (rows @ prior.factor).square().sum()
            torch.testing.assert_close(bump * 0.1, moved * share, atol=1e-6, rtol=1e-5)


def test_every_trajectory_meets_the_constraints(bumped):
    _, found, _ = bumped
    numbers = 0.3 * scale_of([found]) * np.random.default_rng(0).standard_normal((6, 30))
    trajectories = found.trajectories(numbers)
    assert np.abs(trajectories - found.mean).max() > 0.2
    for constraint in found.problem.constraints:
        missed = constraint.missed(trajectories) - constraint.missed(found.mean[None])
        if constraint.name in ("start", "rest at the start", "rest at the end"):
            np.testing.assert_allclose(missed, 0.0, atol=1e-6)
    np.testing.assert_allclose(
        found.posterior.trajectory(found.weights(numbers), 200).numpy(), trajectories, atol=1e-9
    )
    latent = found.posterior.whiten(found.weights(numbers))
    np.testing.assert_allclose(found.surprise(numbers), 0.5 * (latent**2).sum(-1))
    # From 0 to 1 in steps of a third as many.
    finer = found.resampled(598).trajectories(numbers)
    np.testing.assert_allclose(finer[:, ::3], trajectories, atol=1e-9)


def test_what_the_softened_check_calls_clear_is_good(bumped):
    _, found, settings = bumped
    numbers = 0.2 * scale_of([found]) * np.random.default_rng(1).standard_normal((40, 30))
    trajectories = found.trajectories(numbers)
    check = SoftenedCheck(found.problem, 40, floor=-1.0)
    clear = check.clearance(found.resampled(40).trajectories(numbers)) > 0.0
    good = assess(found.problem, trajectories, settings).good
    # Between samples it is a guess; it may err for a few of those that are nearly touching.
    assert (clear != good).sum() <= 3


@pytest.mark.parametrize("task", ["Placement", "PushLiftBox", "DoubleSidedPlacement"])
def test_what_misses_the_goal_is_not_clear_however_far_it_is_from_obstacles(task):
    (problem,) = posed([sample_scene(task, "easy", 3)])
    planner = primitive_of(task)
    settings = planner.plan_settings
    stages = tuple(replace(stage, obstacles=()) for stage in problem.stages)
    empty = replace(problem, stages=stages)
    found = bumped_mean(planner.prior.components()[0], empty, settings, bump_phases(2), 40)
    # In its last quarter the base turns on, and the hand is carried past the goal.
    turned = np.zeros((5, 40, 6))
    turned[:, 30:, 0] = np.outer((0.0, 0.1, 0.2, -0.2, 0.3), np.linspace(0.1, 1.0, 10))
    trajectories = found.mean + turned
    (goal,) = (each for each in problem.constraints if each.name == "goal")
    missed = goal.missed(trajectories)
    clearance = SoftenedCheck(empty, 40, floor=-1.0, settings=settings).clearance(trajectories)
    assert clearance[0] > 0.0
    astray = missed > settings.sigma
    assert astray.sum() >= 2
    # Less the slack, and what is demanded between samples.
    np.testing.assert_allclose(clearance[astray], settings.sigma - missed[astray] - 0.003)
