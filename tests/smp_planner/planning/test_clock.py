"""How phase runs in time: limits of the joints, and a beginning in motion."""

import numpy as np
import pytest

from smp_gym.observation import CONTROL_PERIOD
from smp_planner.collision.costs import VELOCITY_FRACTION
from smp_planner.collision.verification import minimum_duration
from smp_planner.planning.clock import RAMP, Clock, segment_rates

VELOCITY = np.array([0.6, 0.8])


def _paths() -> np.ndarray:
    phase = np.linspace(0.0, 1.0, 201)
    return np.stack(
        [
            np.stack([np.sin(2.0 * phase), phase**2], axis=1),
            np.stack([0.2 * phase, 3.0 * phase - phase**2], axis=1),
        ]
    )


def test_from_rest_the_whole_takes_the_shortest_duration_that_limits_allow():
    times = Clock(delay=0.1).times(_paths(), VELOCITY)
    np.testing.assert_allclose(times[:, 0], 0.1)
    np.testing.assert_allclose(times[:, -1] - 0.1, minimum_duration(_paths(), VELOCITY))
    np.testing.assert_allclose(np.diff(times), np.diff(times)[:, :1] * np.ones((1, 200)))


@pytest.mark.parametrize("rate", [0.0, 0.05, 0.4])
def test_the_rate_changes_evenly_within_the_ramp(rate):
    """Independent truth: the phase, integrated in small steps of time."""
    most = 0.05
    clock = Clock(0.31, 0.1, rate, most)
    times = clock.times(_paths(), VELOCITY)
    assert (segment_rates(_paths(), VELOCITY, most) == most).all()
    step = 1e-4
    for path_times in times:
        assert (path_times[: 63 - 1] == 0.1).all()
        moments = np.arange(0.0, 60.0, step)
        rates = rate + (most - rate) * np.minimum((moments + step / 2) / RAMP, 1.0)
        phases = 0.31 + np.cumsum(rates) * step
        for sample in (70, 90, 140, 200):
            reached = moments[np.searchsorted(phases, sample / 200)] + step
            assert path_times[sample] - 0.1 == pytest.approx(reached, abs=2e-3)


def test_each_stretch_is_as_fast_as_it_allows_and_is_slowed_down_for_in_time():
    paths, most = _paths(), 0.5
    rates = segment_rates(paths, VELOCITY, most)
    velocities = np.abs(np.diff(paths, axis=1)) * 200 * rates[..., None]
    assert (velocities <= VELOCITY_FRACTION * VELOCITY * (1.0 + 1e-9)).all()
    # By hand: on each segment the least of what follows within the braking distance.
    own = VELOCITY_FRACTION * VELOCITY / np.maximum(np.abs(np.diff(paths, axis=1)) * 200, 1e-9)
    own = np.minimum(own.min(axis=2), most)
    for row, found in zip(own, rates, strict=True):
        for segment in (0, 57, 120, 199):
            reach = int(row.max() * (0.5 * RAMP + 2.0 * CONTROL_PERIOD) * 200) + 2
            assert found[segment] == pytest.approx(row[segment : segment + reach].min())
    assert (rates.max(axis=1) > 1.2 * rates.min(axis=1)).any()
    # In motion at that rate, the phase passes samples as the rates say.
    times = Clock(0.0, 0.0, float(rates[0, 0]), most).times(paths[:1], VELOCITY)[0]
    np.testing.assert_allclose(times[1:], np.cumsum(1.0 / rates[0]) / 200, atol=1e-3)


def test_only_the_rest_of_the_trajectory_limits_the_rate():
    paths = _paths()
    paths[0, :50] *= 10.0
    assert Clock(0.5).rates(paths, VELOCITY)[0] > 2.0 * Clock(0.0).rates(paths, VELOCITY)[0]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"phase": 1.0}, r"phase must lie in \[0, 1\), got 1.0"),
        ({"delay": -0.1}, "delay must be finite and not negative, got -0.1"),
        ({"rate": np.nan}, "rate must be finite, got nan"),
    ],
)
def test_clocks_refuse_bad_numbers(change, message):
    with pytest.raises(ValueError, match=message):
        Clock(**change)
