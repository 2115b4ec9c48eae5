"""The exponential method of multipliers: its penalty, its update, and a solution in closed form."""

import math

import pytest
import torch

from smp_planner.inference.multipliers import penalty, penalty_slope, updated_multipliers


def test_the_penalty_is_an_exponential_that_goes_on_as_its_quadratic():
    low = torch.linspace(-5.0, 1.0, 7, dtype=torch.float64)
    torch.testing.assert_close(penalty(low), low.exp() - 1.0)
    high = torch.tensor([3.0], dtype=torch.float64)
    assert float(penalty(high)) == pytest.approx(math.e * (1.0 + 2.0 + 2.0) - 1.0)
    near = torch.tensor([0.3, 1.0, 1.0 + 1e-7, 4.0], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(penalty, (near,))
    assert torch.autograd.gradgradcheck(penalty, (near[[0, 3]].detach().requires_grad_(),))


def test_the_factor_of_an_update_is_the_slope_of_the_penalty_within_bounds():
    excess = torch.tensor([-30.0, -1.0, 0.0, 0.5, 2.0, 50.0], dtype=torch.float64)
    given = excess.clone().requires_grad_()
    (slope,) = torch.autograd.grad(penalty(given).sum(), given)
    found = updated_multipliers(torch.full_like(excess, 2.0), excess, 1e-9, 1e3)
    torch.testing.assert_close(penalty_slope(excess), slope)
    torch.testing.assert_close(found, 2.0 * slope.clamp(0.5, 2.0))
    bounded = updated_multipliers(found, excess, 1.5, 3.0)
    assert bounded.tolist() == pytest.approx([1.5, 1.5, 2.0, 3.0, 3.0, 3.0])
    for least, largest in ((0.0, 1.0), (2.0, 1.0), (float("nan"), 1.0)):
        with pytest.raises(ValueError, match="least and largest"):
            updated_multipliers(found, excess, least, largest)


def test_multipliers_of_a_quadratic_program_are_its_dual_solution():
    """The point nearest to 0 with x >= 2, y >= -1: x = 2 with multiplier 2, y = 0 with none."""
    width, bound = 0.1, torch.tensor([2.0, -1.0], dtype=torch.float64)
    multipliers = torch.ones(2, dtype=torch.float64)
    point = torch.zeros(2, dtype=torch.float64)
    for _ in range(40):
        for _ in range(60):
            given = point.clone().requires_grad_()
            value = 0.5 * given.square().sum()
            value = value + (multipliers * penalty((bound - given) / width)).sum()
            (slope,) = torch.autograd.grad(value, given, create_graph=True)
            rows = [torch.autograd.grad(s, given, retain_graph=True)[0] for s in slope]
            step = torch.linalg.solve(torch.stack(rows), slope.detach())
            point = point - step * min(1.0, 0.3 / float(step.abs().max() + 1e-12))
        excess = (bound - point) / width
        lagrange = multipliers * penalty_slope(excess) / width
        multipliers = updated_multipliers(multipliers, excess, 1e-3, 100.0)
    assert point.tolist() == pytest.approx([2.0, 0.0], abs=1e-6)
    assert lagrange.tolist() == pytest.approx([2.0, 0.0], abs=1e-5)
