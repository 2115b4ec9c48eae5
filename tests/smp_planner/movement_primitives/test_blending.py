"""Blended primitives against the product of Gaussians, phase by phase."""

import math

import pytest
import torch

from smp_planner.movement_primitives import GaussianBasis, ProMP, blend, phases, smooth_covariance

BASIS = GaussianBasis(15)
SAMPLES = 100
AT = phases(SAMPLES)


def primitive(seed: int, dimension: int = 2, basis: GaussianBasis = BASIS) -> ProMP:
    """Return a smooth primitive of which the dimensions covary."""
    generator = torch.Generator().manual_seed(seed)
    steps = torch.randn(basis.count, dimension, generator=generator, dtype=torch.float64)
    mixing = torch.randn(dimension, dimension, generator=generator, dtype=torch.float64)
    mixing = torch.eye(dimension, dtype=torch.float64) + 0.15 * mixing
    many = torch.kron(torch.eye(basis.count, dtype=torch.float64), mixing)
    covariance = many @ smooth_covariance(basis, dimension, 0.3, 0.2) @ many.mT
    noise = torch.full((dimension,), 1e-3 * (seed + 1), dtype=torch.float64)
    return ProMP.from_covariance(basis, 0.2 * steps.cumsum(0).flatten(), covariance, noise)


def product(primitives, activations, phase):
    """Return mean and covariance of the product of the marginals at a phase."""
    precision, weighted = 0.0, 0.0
    for one, activation in zip(primitives, activations, strict=True):
        mean, covariance = one.marginal(phase)
        inverse = activation * torch.linalg.inv(covariance)
        precision, weighted = precision + inverse, weighted + inverse @ mean
    covariance = torch.linalg.inv(precision)
    return covariance @ weighted, covariance


RISE = 0.5 - 0.5 * torch.cos(math.pi * AT)
PROFILES = {
    "both at once": torch.ones(2, SAMPLES).double(),
    "half and half": torch.full((2, SAMPLES), 0.5).double(),
    "from one to the other": torch.stack([1.0 - RISE, RISE]),
    "over two spacings": torch.stack(
        [torch.sigmoid((0.5 - AT) / 0.05), torch.sigmoid((AT - 0.5) / 0.05)]
    ),
}


@pytest.mark.parametrize("dimension", [2, 3, 6])
@pytest.mark.parametrize("profile", PROFILES)
def test_marginals_are_the_product_of_the_marginals(profile, dimension):
    primitives = [primitive(0, dimension), primitive(1, dimension)]
    blended = blend(primitives, PROFILES[profile])
    assert blended.mean.shape == primitives[0].mean.shape
    for index in range(0, SAMPLES, 9):
        phase = float(AT[index])
        mean, covariance = product(primitives, PROFILES[profile][:, index], phase)
        found_mean, found = blended.marginal(phase)
        # The rest is what 15 basis functions cannot follow, in standard deviations.
        off = (found_mean - mean) / covariance.diagonal().sqrt()
        assert float(off.abs().max()) < 0.03
        torch.testing.assert_close(found, covariance, rtol=0, atol=5e-3 * float(covariance.max()))


def test_where_one_is_active_alone_it_comes_back_even_if_it_is_certain_somewhere():
    one = primitive(0).condition(0.0, torch.zeros(2, dtype=torch.float64))
    only = torch.zeros(2, SAMPLES).double()
    only[0] = 1.0
    for primitives, activations in (
        ([one, primitive(1)], only),
        ([primitive(1), one], only.flip(0)),
        ([one], only[:1]),
    ):
        blended = blend(primitives, activations)
        torch.testing.assert_close(blended.mean, one.mean, atol=1e-11, rtol=0)
        torch.testing.assert_close(blended.covariance, one.covariance, atol=1e-11, rtol=0)
        torch.testing.assert_close(blended.noise, one.noise)
        assert blended.rank == one.rank


def test_the_order_of_primitives_does_not_matter_and_scales_of_activation_do():
    primitives, activations = [primitive(0), primitive(1)], PROFILES["from one to the other"]
    a, b = blend(primitives, activations), blend(primitives[::-1], activations.flip(0))
    torch.testing.assert_close(a.mean, b.mean, atol=1e-11, rtol=0)
    torch.testing.assert_close(a.covariance, b.covariance, atol=1e-11, rtol=0)
    twice = blend(primitives, 2.0 * activations)
    torch.testing.assert_close(twice.mean, a.mean, atol=1e-11, rtol=0)
    torch.testing.assert_close(2.0 * twice.covariance, a.covariance, atol=1e-11, rtol=0)
    torch.testing.assert_close(2.0 * twice.noise, a.noise)


def test_samples_of_the_blend_are_smooth_and_go_from_one_mean_to_the_other():
    primitives = [primitive(0), primitive(1)]
    blended = blend(primitives, PROFILES["from one to the other"])
    weights = blended.sample(2000, torch.Generator().manual_seed(0))
    drawn = blended.trajectory(weights, AT).mean(0)
    means = [p.trajectory(p.mean, AT) for p in primitives]
    assert float((drawn[0] - means[0][0]).abs().max()) < 0.05
    assert float((drawn[-1] - means[1][-1]).abs().max()) < 0.05
    # A primitive of its own spread and length scale has velocities of at most about their ratio.
    speed = blended.velocity(weights - blended.mean, AT).square().mean().sqrt()
    assert float(speed) < 2 * 0.3 / 0.2


def test_a_blend_can_be_conditioned_and_means_keep_their_leading_dimensions():
    goal = torch.tensor([0.4, -0.2], dtype=torch.float64)
    noisy = torch.full((2,), 1e-2, dtype=torch.float64)
    several = primitive(0).condition(1.0, torch.stack([goal, -goal])[:, None], noisy)
    blended = blend([several, primitive(1)], PROFILES["half and half"])
    assert blended.mean.shape == (2, 1, 30)
    single = blend(
        [primitive(0).condition(1.0, -goal, noisy), primitive(1)], PROFILES["half and half"]
    )
    torch.testing.assert_close(blended.mean[1, 0], single.mean, atol=1e-11, rtol=0)
    certain = single.condition(0.0, goal)
    start = certain.trajectory(certain.sample(5, torch.Generator().manual_seed(0)), 10)[:, 0]
    torch.testing.assert_close(start, goal.expand(5, 2), atol=1e-12, rtol=0)


HALVES = PROFILES["half and half"]
NEGATIVE, SILENT = HALVES.clone(), HALVES.clone()
NEGATIVE[0, 3] = -0.1
SILENT[:, 7] = 0.0


@pytest.mark.parametrize(
    ("primitives", "activations", "message"),
    [
        ([], HALVES, "primitives must hold at least one"),
        ([primitive(0), primitive(1, 3)], HALVES, "one basis and dimension"),
        ([primitive(0), primitive(1, basis=GaussianBasis(9))], HALVES, "one basis and dimension"),
        ([primitive(0)], HALVES, r"activations must have shape \(1, T\)"),
        ([primitive(0), primitive(1)], HALVES[:, :14], "T of at least 15"),
        ([primitive(0), primitive(1)], NEGATIVE, "activations must be finite and not negative"),
        ([primitive(0), primitive(1)], HALVES * math.nan, "activations must be finite"),
        ([primitive(0), primitive(1)], SILENT, "all be zero at one phase, as at sample 7"),
        (
            [primitive(0), primitive(1).condition(0.0, torch.zeros(2))],
            HALVES,
            r"primitives\[1\] is certain at phase 0, where another is active, too",
        ),
    ],
)
def test_bad_blends_are_errors(primitives, activations, message):
    with pytest.raises(ValueError, match=message):
        blend(primitives, activations)
