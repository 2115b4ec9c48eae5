"""Tries of problems: how many particles and how wide a prior each has, and what is kept of them."""

import gymnasium
import numpy as np
import pytest

from smp_gym.observation import decode
from smp_planner.planners import make_planner
from smp_planner.planning.settings import PlanSettings
from smp_planner.planning.tries import tries
from smp_planner.policy.observed_problem import problem_from


def test_a_population_grows_before_the_prior_widens():
    settings = PlanSettings(particles=10, retries=3)
    assert tries(settings, compete=True) == [(10, 1.0), (40, 1.0), (40, 2.0), (40, 4.0)]
    assert tries(settings, compete=False) == [(10, 1.0), (10, 2.0), (10, 4.0), (10, 8.0)]


@pytest.fixture(scope="module")
def cages():
    """Openings that a small population often does not find."""
    env = gymnasium.make("smp_gym/Placement-v0", difficulty="hard", family="cage")
    problems = []
    for seed in range(79_960, 79_966):
        observation, _ = env.reset(seed=seed)
        problems.append(problem_from(decode(observation, "Placement"), seed=seed))
    env.close()
    return problems


def test_another_try_solves_what_the_first_did_not_and_keeps_as_many_particles(cages):
    few = {"particles": 14, "samples": 100}
    planners = [
        make_planner("smp", "Placement", settings=few | {"retries": retries}) for retries in (0, 2)
    ]
    once, again = (planner.plan(cages) for planner in planners)
    unsolved = [not plan.solved for plan in once].index(True)
    asked_for_one = planners[1].plan_once(cages[unsolved])
    np.testing.assert_array_equal(asked_for_one.trajectories, once[unsolved].trajectories)
    solved = [np.array([plan.solved for plan in plans]) for plans in (once, again)]
    assert solved[1].sum() > solved[0].sum()
    for first, last in zip(once, again, strict=True):
        assert len(last.trajectories) == len(last.weights) == 14
        assert sum(len(part.latent) for part in last.state.parts) == 14
        assert len({tuple(weights.ravel()) for weights in last.weights}) == 14
        if first.solved:
            np.testing.assert_array_equal(first.trajectories, last.trajectories)


def test_particles_of_a_larger_population_are_kept_part_by_part(cages):
    """What is kept belongs to the primitives that are said to have made it."""
    settings = {"particles": 14, "samples": 100, "retries": 2}
    for plan in make_planner("smp", "Placement", settings=settings).plan(cages):
        weights = np.concatenate(
            [part.primitive.unwhiten(part.latent).numpy() for part in plan.state.parts]
        )
        np.testing.assert_allclose(weights, plan.weights.reshape(14, -1), rtol=0, atol=1e-12)
