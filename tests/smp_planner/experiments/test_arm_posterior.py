"""Draws of the posterior of a scene, and the distance of sets to it."""

import numpy as np
import pytest
from scipy.stats import energy_distance as one_dimensional

from smp_gym.sampling import sample_scene
from smp_planner.benchmark.metrics import energy_distance, rms_distances
from smp_planner.experiments.arm_posterior import posterior_draws
from smp_planner.inference.smc import SMCSettings
from smp_planner.planners import make_planner


def test_the_energy_distance_is_scipy_s_but_for_the_bias():
    rng = np.random.default_rng(0)
    a, b = rng.normal(0.0, 1.0, 60), rng.normal(0.7, 2.0, 80)
    within = [np.abs(x[:, None] - x).sum() / len(x) ** 2 / (len(x) - 1) for x in (a, b)]
    # Paths that stand still are as far from each other as their points.
    still = [np.repeat(x[:, None, None], 2, axis=1) for x in (a, b)]
    found = energy_distance(*still)
    assert found + sum(within) == pytest.approx(one_dimensional(a, b) ** 2, rel=1e-9)


def test_draws_of_one_distribution_are_at_no_distance_in_the_mean():
    rng = np.random.default_rng(1)
    found = [
        energy_distance(*(rng.standard_normal((30, 4, 2)) for _ in range(2))) for _ in range(200)
    ]
    assert abs(np.mean(found)) < 3.0 * np.std(found) / np.sqrt(200)


def test_where_nothing_is_in_the_way_the_posterior_is_the_conditioned_prior(placement):
    """Against as many plain draws of it that the exact check finds good, by a permutation test."""
    problem = placement(sample_scene("Placement", "none", 79_002))
    settings = {"widths": (1.0,), "margin": 0.0, "edge_width": (0.001, 0.001)}
    planner = make_planner("smp", "Placement", settings=settings)
    rng = np.random.default_rng(0)
    few = SMCSettings(150, moves=2, last_moves=10)
    draws = posterior_draws(planner.prior, problem, planner.plan_settings, rng, few)
    (plan,) = make_planner("promp", "Placement", settings={"particles": 300}).plan([problem])
    plain = plan.trajectories[plan.good][:150]
    assert len(draws) > 120
    assert len(plain) > 100
    both = np.concatenate([draws, plain])[:, ::10]
    between, count = rms_distances(both, both), len(draws)

    def energy(order):
        parts = order[:count], order[count:]
        within = [between[np.ix_(x, x)].sum() / (len(x) * (len(x) - 1)) for x in parts]
        return 2.0 * between[np.ix_(*parts)].mean() - sum(within)

    found = energy(np.arange(len(both)))
    assert found == pytest.approx(energy_distance(draws[:, ::10], plain[:, ::10]))
    shuffled = [energy(rng.permutation(len(both))) for _ in range(99)]
    assert found < np.quantile(shuffled, 0.99)
