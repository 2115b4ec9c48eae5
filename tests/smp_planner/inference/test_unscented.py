"""The unscented transform against closed forms."""

import pytest
import torch

from smp_planner.inference.unscented import sigma_points, unscented_moments


def gaussian(dimension, batch=3):
    generator = torch.Generator().manual_seed(dimension)
    draw = {"generator": generator, "dtype": torch.float64}
    mean = torch.randn(batch, dimension, **draw)
    root = torch.randn(batch, dimension, dimension, **draw)
    return mean, root @ root.mT + 0.1 * torch.eye(dimension, dtype=torch.float64)


@pytest.mark.parametrize("dimension", [1, 2, 6])
def test_moments_of_linear_functions_are_exact(dimension):
    mean, covariance = gaussian(dimension)
    rows = torch.randn(4, dimension, dtype=torch.float64)
    values = sigma_points(mean, covariance) @ rows.mT + 0.7
    found, variance = unscented_moments(values)
    torch.testing.assert_close(found, mean @ rows.mT + 0.7)
    expected = torch.einsum("md,bde,me->bm", rows, covariance, rows)
    torch.testing.assert_close(variance, expected)


def test_the_mean_of_a_quadratic_is_exact():
    mean, covariance = gaussian(4)
    form = torch.randn(4, 4, dtype=torch.float64)
    points = sigma_points(mean, covariance)
    values = torch.einsum("bpd,de,bpe->bp", points, form, points)[..., None]
    found, variance = unscented_moments(values)
    expected = torch.einsum("bd,de,be->b", mean, form, mean)
    expected = expected + torch.einsum("de,bde->b", form, covariance)
    torch.testing.assert_close(found[:, 0], expected)
    assert (variance >= 0.0).all()


def test_gradients_by_finite_differences():
    mean, covariance = gaussian(3, batch=2)

    def std(shift, scale):
        points = sigma_points(mean + shift, scale * covariance)
        middle, variance = unscented_moments(points.sin())
        return middle, variance.sqrt()

    given = (torch.zeros(3, dtype=torch.float64), torch.ones(1, dtype=torch.float64))
    assert torch.autograd.gradcheck(std, tuple(g.requires_grad_() for g in given))


def test_bad_arguments_are_named():
    mean, covariance = gaussian(3)
    with pytest.raises(ValueError, match=r"covariance must have shape \(3, 3, 3\)"):
        sigma_points(mean, covariance[..., :2])
    with pytest.raises(ValueError, match="positive definite"):
        sigma_points(mean, -covariance)
    for values in (torch.zeros(4, 2), torch.zeros(1, 2), torch.zeros(5)):
        with pytest.raises(ValueError, match="values must have shape"):
            unscented_moments(values)
