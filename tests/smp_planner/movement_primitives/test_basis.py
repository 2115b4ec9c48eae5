"""Basis functions against their definition in numpy, finite differences and linear algebra."""

import numpy as np
import pytest
import torch

from smp_planner.movement_primitives import GaussianBasis, phases


def test_values_are_the_normalised_gaussians_of_the_definition():
    basis = GaussianBasis(15, outside=1)
    phase = np.linspace(0, 1, 37)
    centers = np.arange(-1, 14) / 12
    bumps = np.exp(-((phase[:, None] - centers) ** 2) / (2 * (1 / 12) ** 2))
    expected = bumps / bumps.sum(1, keepdims=True)
    np.testing.assert_allclose(basis.values(torch.from_numpy(phase)).numpy(), expected, atol=1e-14)


@pytest.mark.parametrize(("count", "outside"), [(15, 1), (5, 0), (20, 2)])
def test_centers_are_equally_spaced_and_reach_over_both_ends(count, outside):
    basis = GaussianBasis(count, outside)
    centers = basis.centers()
    torch.testing.assert_close(centers.diff(), torch.full_like(centers.diff(), basis.width))
    assert int((centers < -1e-12).sum()) == int((centers > 1 + 1e-12).sum()) == outside


@pytest.mark.parametrize("basis", [GaussianBasis(), GaussianBasis(6, 0), GaussianBasis(30, 3)])
def test_derivatives_agree_with_finite_differences(basis):
    step = 1e-6
    phase = torch.linspace(step, 1 - step, 41, dtype=torch.float64)
    difference = (basis.values(phase + step) - basis.values(phase - step)) / (2 * step)
    torch.testing.assert_close(basis.derivatives(phase), difference, atol=1e-7, rtol=1e-7)


def test_a_constant_is_reproduced_exactly_and_a_line_nearly():
    values = GaussianBasis().values(phases(200))
    torch.testing.assert_close(values.sum(-1), torch.ones(200, dtype=torch.float64))
    line = phases(200)
    weights = torch.linalg.lstsq(values, line[:, None]).solution
    assert float((values @ weights - line[:, None]).abs().max()) < 1e-3


def test_leading_dimensions_and_dtype_follow_the_phase():
    phase = torch.rand(2, 3, 4, dtype=torch.float32)
    basis = GaussianBasis(8)
    assert basis.values(phase).shape == basis.derivatives(phase).shape == (2, 3, 4, 8)
    assert basis.values(phase).dtype == torch.float32
    torch.testing.assert_close(basis.values(phase)[1, 2], basis.values(phase[1, 2]))


@pytest.mark.parametrize("phase", [-1e-9, 1.0 + 1e-9, float("nan"), float("inf")])
@pytest.mark.parametrize("method", ["values", "derivatives"])
def test_a_phase_outside_zero_to_one_is_an_error(phase, method):
    with pytest.raises(ValueError, match=r"phase must be in \[0, 1\]"):
        getattr(GaussianBasis(), method)(torch.tensor([0.5, phase], dtype=torch.float64))


@pytest.mark.parametrize(
    ("count", "outside", "message"),
    [(3, 1, r"count must be a whole number at least 4, got 3"), (9, -1, "outside")],
)
def test_a_basis_without_room_is_an_error(count, outside, message):
    with pytest.raises(ValueError, match=message):
        GaussianBasis(count, outside)


def test_too_few_phases_are_an_error():
    with pytest.raises(ValueError, match="count of phases must be at least 2, got 1"):
        phases(1)


@pytest.mark.parametrize("samples", [10, 50])
def test_path_root_measures_the_mean_square_of_a_path(samples):
    basis = GaussianBasis(15)
    weights = torch.randn(15, 6, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    path = basis.values(phases(samples)) @ weights
    root = basis.path_root(samples)
    assert root.shape == (min(samples, 15), 15)
    torch.testing.assert_close((root @ weights).square().sum(0), path.square().mean(0))
