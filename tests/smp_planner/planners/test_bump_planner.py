"""Learned proposals: mean action, draws around it, heads, further tries while none is good."""

import dataclasses

import numpy as np
import pytest
import torch

from smp_gym.sampling import sample_scene
from smp_planner.agents.posed_scenes import posed
from smp_planner.planners import make_planner
from smp_planner.planners.agent_file import write_agent
from smp_planner.planners.bump_policy import BumpPolicy, NetworkShape

FIRST, SECOND, THIRD, NEVER = 74200, 74207, 74224, 74202
"""Tuning seeds of Placement at easy, by the try of `mp_rl` that has a good proposal."""


def plan(seed, **settings):
    (problem,) = posed([sample_scene("Placement", "easy", seed)])
    (found,) = make_planner("mp_rl", "Placement", settings=settings).plan([problem])
    return found


@pytest.mark.parametrize(("seed", "tries", "count"), [(FIRST, 1, 42), (SECOND, 2, 168)])
def test_it_tries_again_only_while_no_proposal_is_good(seed, tries, count):
    found = plan(seed)
    assert found.solved
    assert found.trajectories.shape[0] == count
    enough = plan(seed, retries=tries - 1)
    np.testing.assert_array_equal(enough.trajectories, found.trajectories)
    if tries > 1:
        fewer = plan(seed, retries=tries - 2)
        assert not fewer.solved
        assert fewer.trajectories.shape[0] == 42


def test_of_tries_that_all_fail_the_first_is_taken():
    found, once = plan(NEVER), plan(NEVER, retries=0)
    assert not found.solved
    np.testing.assert_array_equal(found.trajectories, once.trajectories)


def test_the_last_try_spreads_twice_as_far_around_the_mean_action():
    mean = plan(THIRD, action="mean").trajectories
    assert mean.shape[0] == 1
    once, last = (plan(THIRD, retries=retries).trajectories for retries in (0, 2))
    np.testing.assert_allclose(once[:1], mean)
    spread = [np.sqrt(np.mean((paths - mean) ** 2)) for paths in (once[1:], last)]
    assert spread[1] / spread[0] == pytest.approx(2.0, rel=0.15)


def test_the_mean_action_alone_has_one_try():
    found = plan(SECOND, action="mean")
    assert found.trajectories.shape[0] == 1
    one = plan(SECOND, particles=1, retries=0)
    np.testing.assert_array_equal(one.trajectories, found.trajectories)


def test_each_head_proposes_on_the_mean_of_its_component(tmp_path):
    task, heads = "DoubleSidedPlacement", 3
    planner = make_planner("detour", task)
    card = dataclasses.replace(planner.card, bumps=1, network={}, scores={})
    policy = BumpPolicy(NetworkShape(6, 2, sees=False, heads=heads))
    with torch.no_grad():
        for component, head in np.ndindex(2, heads):
            policy.constant.view(2, heads, 7)[component, head, 1:] = 0.1 * head
    (problem,) = posed([sample_scene(task, "easy", 74201)])
    found = {}
    for component, head in np.ndindex(2, heads):
        with torch.no_grad():
            choice = policy.constant.view(2, heads, 7)[..., 0]
            choice.fill_(-30.0)
            choice[component, head] = 30.0
        path = tmp_path / f"{component}{head}.json"
        write_agent(
            path, policy, dataclasses.replace(card, network=dataclasses.asdict(policy.shape))
        )
        own = {"agent": str(path), "particles": 3, "retries": 0}
        (plan,) = make_planner("detour", task, settings=own).plan([problem])
        assert plan.components.tolist() == [component] * 3
        found[component, head] = plan.trajectories[0]
    for component in (0, 1):
        bent = [np.abs(found[component, h] - found[component, 0]).max() for h in range(heads)]
        # The second is bent twice as far as the first.
        assert bent[2] == pytest.approx(2.0 * bent[1], rel=1e-3)
        assert bent[1] > 0.02
