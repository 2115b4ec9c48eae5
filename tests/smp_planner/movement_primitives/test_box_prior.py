"""The smooth box prior against finite differences, quadrature and its Gaussian limit."""

import math

import pytest
import torch
from scipy.integrate import quad

from smp_planner.movement_primitives import SmoothBox

LOWER = torch.tensor([-0.1, 0.2, 0.5], dtype=torch.float64)
UPPER = torch.tensor([0.3, 0.2, 0.9], dtype=torch.float64)
SIGMA = torch.tensor([0.05, 0.1, 0.2], dtype=torch.float64)


def _points(count: int = 64) -> torch.Tensor:
    generator = torch.Generator().manual_seed(0)
    return torch.randn(count, 3, generator=generator, dtype=torch.float64)


@pytest.mark.parametrize("paper_scale", [False, True])
def test_score_agrees_with_finite_differences(paper_scale):
    box = SmoothBox(LOWER, UPPER, SIGMA, paper_scale)
    points, step = _points(), 1e-5
    for dimension in range(3):
        shift = torch.zeros(3, dtype=torch.float64)
        shift[dimension] = step
        difference = (box.log_prob(points + shift) - box.log_prob(points - shift)) / (2 * step)
        torch.testing.assert_close(box.score(points)[:, dimension], difference, atol=1e-4, rtol=0)


def test_score_is_continuous_at_the_wall():
    box = SmoothBox(LOWER, UPPER, SIGMA)
    wall = torch.stack([UPPER - 1e-9, UPPER, UPPER + 1e-9])
    assert float(box.score(wall)[:, [0, 2]].abs().max()) < 1e-5


def test_inside_the_density_is_flat_and_the_score_zero():
    box = SmoothBox(LOWER, UPPER, SIGMA)
    inside = torch.stack([LOWER, (LOWER + UPPER) / 2, UPPER])
    assert box.contains(inside).tolist() == [True, True, True]
    assert not bool(box.contains(UPPER + 1e-6))
    assert float(box.score(inside).abs().max()) == 0.0
    assert float(box.log_prob(inside).std()) == 0.0


@pytest.mark.parametrize(("paper_scale", "scale"), [(False, 2.0), (True, math.sqrt(2.0))])
def test_the_tails_have_the_printed_or_the_gaussian_scale(paper_scale, scale):
    box = SmoothBox(LOWER, UPPER, SIGMA, paper_scale)
    offset = torch.tensor([0.04, 0.0, 0.07], dtype=torch.float64)
    fall = box.log_prob(UPPER) - box.log_prob(UPPER + offset)
    expected = 0.04**2 / (scale * 0.05**2) + 0.07**2 / (scale * 0.2**2)
    assert float(fall) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("paper_scale", [False, True])
def test_the_density_integrates_to_one(paper_scale):
    box = SmoothBox(LOWER[:1], UPPER[:1], SIGMA[:1], paper_scale)
    integral, _ = quad(
        lambda x: float(box.log_prob(torch.tensor([x], dtype=torch.float64)).exp()),
        -1.0,
        1.2,
        points=[-0.1, 0.3],
    )
    assert integral == pytest.approx(1.0, abs=1e-9)


def test_an_empty_box_is_a_gaussian():
    mean = torch.zeros(3, dtype=torch.float64)
    box = SmoothBox(mean, mean, SIGMA)
    expected = torch.distributions.Normal(mean, SIGMA).log_prob(_points()).sum(-1)
    torch.testing.assert_close(box.log_prob(_points()), expected)


def test_leading_dimensions():
    box = SmoothBox(LOWER, UPPER, 0.1)
    points = _points(24).view(2, 3, 4, 3)
    assert box.log_prob(points).shape == (2, 3, 4)
    assert box.score(points).shape == points.shape


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((UPPER, LOWER, SIGMA), "lower must be finite and not exceed upper"),
        ((LOWER, UPPER[:2], SIGMA), "vectors of one length"),
        ((LOWER * math.nan, UPPER, SIGMA), "lower must be finite"),
        ((LOWER, UPPER * math.inf, SIGMA), "lower must be finite"),
        ((LOWER, UPPER, 0.0), "sigma must be positive"),
        ((LOWER, UPPER, math.nan), "sigma must be positive"),
        ((LOWER, UPPER, SIGMA[:2]), "sigma must be one number or have shape"),
    ],
)
def test_bad_boxes_are_errors(arguments, message):
    with pytest.raises(ValueError, match=message):
        SmoothBox(*arguments)


def test_a_value_of_another_dimension_is_an_error():
    with pytest.raises(ValueError, match=r"value must have shape \(\.\.\., 3\), got \(5, 2\)"):
        SmoothBox(LOWER, UPPER, SIGMA).score(torch.zeros(5, 2))
