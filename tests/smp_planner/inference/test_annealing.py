"""Schedules against what they promise."""

import math
from itertools import pairwise

import pytest

from smp_planner.inference.annealing import cyclic_annealing, linear_decay, tanh_annealing


def test_tanh_annealing_rises_to_one_and_stays():
    factors = [tanh_annealing(i, 100, 0.7) for i in range(100)]
    assert 0 < factors[0] < 0.05
    assert all(a < b for a, b in pairwise(factors[:70]))
    assert factors[69:] == pytest.approx([1.0] * 31)
    assert factors[34] == pytest.approx(math.tanh(0.65) / math.tanh(1.3))


def test_cyclic_annealing_rises_to_one_in_every_cycle_and_stays():
    factors = [cyclic_annealing(i, 100, 0.8, cycles=4) for i in range(100)]
    ramp = [n / 20 for n in range(1, 21)]
    assert factors[:80] == pytest.approx(ramp * 4)
    assert factors[80:] == [1.0] * 20


@pytest.mark.parametrize(("iterations", "fraction", "cycles"), [(100, 0.7, 4), (7, 0.9, 3)])
def test_cycles_that_do_not_divide_the_run_have_the_stated_number_of_rises(
    iterations, fraction, cycles
):
    factors = [cyclic_annealing(i, iterations, fraction, cycles) for i in range(iterations)]
    assert sum(b < a for a, b in pairwise(factors)) == cycles - 1
    assert 0.0 < min(factors) < max(factors) == factors[-1] == 1.0


def test_linear_decay_goes_from_one_to_final():
    factors = [linear_decay(i, 11, 0.1) for i in range(11)]
    assert factors[0] == 1.0
    assert factors[5] == pytest.approx(0.55)
    assert factors[-1] == pytest.approx(0.1)
    assert linear_decay(0, 1, 0.1) == 1.0


@pytest.mark.parametrize("iteration", [-1, 10])
def test_an_iteration_outside_the_run_is_an_error(iteration):
    with pytest.raises(ValueError, match=r"iteration must be in 0 \.\. 9"):
        tanh_annealing(iteration, 10)
    with pytest.raises(ValueError, match=r"iteration must be in 0 \.\. 9"):
        cyclic_annealing(iteration, 10)
    with pytest.raises(ValueError, match=r"iteration must be in 0 \.\. 9"):
        linear_decay(iteration, 10, 0.1)


def test_fractions_out_of_range_are_errors():
    with pytest.raises(ValueError, match=r"fraction must be in \(0, 1\]"):
        tanh_annealing(0, 10, 0.0)
    with pytest.raises(ValueError, match=r"fraction must be in \(0, 1\]"):
        cyclic_annealing(0, 10, 1.5)
    with pytest.raises(ValueError, match="cycles must be at least 1, got 0"):
        cyclic_annealing(0, 10, cycles=0)
    with pytest.raises(ValueError, match=r"final must be in \[0, 1\]"):
        linear_decay(0, 10, 1.5)
