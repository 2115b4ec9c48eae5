"""Speed of environments, measured on ones that take a known time."""

import importlib.util

import pytest

import smp_gym
from smp_gym.inspection import speed


def test_a_rate_counts_the_calls_own_times_only():
    times = iter([0.1, 0.3, 0.2, 0.4, 9.0])
    assert speed._rate(lambda: next(times), 1.0) == pytest.approx(4.0)


def test_a_rate_goes_on_until_the_time_is_spent():
    assert speed._rate(lambda: 0.25, 0.6) == pytest.approx(4.0)


def test_panda_is_known_where_it_is_installed(monkeypatch):
    ours = [entry.id for entry in smp_gym.ENVIRONMENTS]
    for found, known in ((None, ours), (object(), [*ours, speed.PANDA])):
        monkeypatch.setattr(importlib.util, "find_spec", lambda name, found=found: found)
        assert speed.known_ids() == known
