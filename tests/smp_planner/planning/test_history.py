"""Particles on their way from the prior to the posterior, kept where a plan is asked for them."""

import numpy as np
import pytest

from smp_gym.scene import Obstacle
from smp_planner import SMP
from smp_planner.adaptation import adaptation

PHASE = np.linspace(0.0, 1.0, 40)
BALL = Obstacle(shape="sphere", position=(5.0, 0.5, 0.5), size=(0.8, 0.8, 0.8))
REQUEST = {"start": (0.0, 0.0, 0.0), "goal": (10.0, 0.0, 1.0), "particles": 6, "seed": 3}


@pytest.fixture(scope="module")
def primitive():
    """Paths of ten units: what is kept must be in them, too."""
    bows = (-1.0, 0.0, 1.0, 2.0)
    return SMP.fit([np.stack([10 * PHASE, b * np.sin(np.pi * PHASE), PHASE], axis=1) for b in bows])


def planned(primitive, inference, **how):
    method = adaptation("smp", inference=inference, iterations=7)
    return primitive.adapt(BALL, method=method, **REQUEST, **how)


@pytest.mark.parametrize("inference", ["svgd", "tempered"])
def test_to_keep_particles_changes_no_bit_of_the_plan(primitive, inference):
    without = planned(primitive, inference)
    plan = planned(primitive, inference, history=3)
    assert dict(without.history) == {}
    for name in ("trajectories", "clearance", "ranks", "signatures", "weights"):
        np.testing.assert_array_equal(getattr(plan, name), getattr(without, name))
    assert list(plan.timings) == list(without.timings)
    assert list(plan.history) == [0, 3, 6]
    for earlier in plan.history.values():
        assert earlier.trajectories.shape == plan.trajectories.shape
        ends = earlier.trajectories[:, [0, -1]]
        np.testing.assert_allclose(ends, [[REQUEST["start"], REQUEST["goal"]]] * 6, atol=0.05)
        assert not np.array_equal(earlier.trajectories, plan.trajectories)


def test_the_first_ones_are_the_draws_of_the_prior(primitive):
    draws = primitive.adapt(BALL, method="promp", **REQUEST)
    first = planned(primitive, "svgd", history=4).history[0]
    np.testing.assert_array_equal(first.trajectories, draws.trajectories)
    np.testing.assert_array_equal(first.collision_free, draws.collision_free)
    np.testing.assert_array_equal(first.clearance, draws.clearance)


@pytest.mark.parametrize(
    ("how", "message"),
    [
        ({"history": 0}, "history must be a whole number at least 1, got 0"),
        ({"history": True}, "history must be a whole number at least 1, got True"),
        ({"history": 2.5}, "history must be a whole number at least 1, got 2.5"),
        ({"history": 2, "method": "promp"}, "history must be None for this adaptation"),
        ({"history": 2, "method": "cpromp"}, "history must be None for this adaptation"),
        ({"history": 2, "deadline": 3.0}, r"history must be None with a deadline, .* got 2"),
    ],
)
def test_what_cannot_be_kept_is_refused(primitive, how, message):
    with pytest.raises(ValueError, match=message):
        primitive.adapt(BALL, **REQUEST, **how)
