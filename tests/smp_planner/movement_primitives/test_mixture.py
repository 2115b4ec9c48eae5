"""The mixture of primitives against torch's own distributions, autograd and known groups."""

import warnings

import numpy as np
import pytest
import torch

from smp_gym.datasets import lasa
from smp_gym.datasets.demonstrations import Demonstrations
from smp_planner.movement_primitives import (
    GaussianBasis,
    ProMP,
    ProMPMixture,
    demonstrated_modes,
    phases,
    smooth_covariance,
)
from smp_planner.movement_primitives.mixture import shared_out

BASIS = GaussianBasis(4)
SIZE = 8


def primitive(seed, offset=0.0):
    rng = torch.Generator().manual_seed(seed)
    mean = torch.randn(SIZE, generator=rng, dtype=torch.float64) + offset
    half = torch.randn(SIZE, SIZE, generator=rng, dtype=torch.float64)
    covariance = half @ half.mT + 0.1 * torch.eye(SIZE, dtype=torch.float64)
    noise = 0.01 * torch.eye(2, dtype=torch.float64)
    return ProMP.from_covariance(BASIS, mean, covariance, noise)


@pytest.fixture(scope="module")
def mixture():
    return ProMPMixture((primitive(0), primitive(1, offset=1.0)), torch.tensor([3.0, 1.0]))


@pytest.fixture(scope="module")
def weights():
    return torch.randn(5, 6, SIZE, generator=torch.Generator().manual_seed(3), dtype=torch.float64)


def reference(mixture):
    components = torch.distributions.MultivariateNormal(
        torch.stack([c.mean for c in mixture.components]),
        torch.stack([c.covariance for c in mixture.components]),
    )
    shares = torch.distributions.Categorical(torch.tensor([0.75, 0.25], dtype=torch.float64))
    return torch.distributions.MixtureSameFamily(shares, components)


def test_log_prob_is_that_of_torch(mixture, weights):
    torch.testing.assert_close(mixture.log_prob(weights), reference(mixture).log_prob(weights))


def test_score_is_the_gradient_of_the_log_prob(mixture, weights):
    free = weights.clone().requires_grad_()
    (gradient,) = torch.autograd.grad(reference(mixture).log_prob(free).sum(), free)
    torch.testing.assert_close(mixture.score(weights), gradient)


def test_far_from_all_components_the_numbers_stay_finite(mixture):
    far = torch.full((SIZE,), 1e4, dtype=torch.float64)
    assert torch.isfinite(mixture.log_prob(far))
    assert torch.isfinite(mixture.score(far)).all()
    assert mixture.responsibilities(far).sum() == pytest.approx(1.0)


def test_samples_have_the_mixture_s_moments_and_shares(mixture):
    drawn, which = mixture.sample(40_000, torch.Generator().manual_seed(0))
    assert (which == 0).double().mean().item() == pytest.approx(0.75, abs=0.01)
    expected = reference(mixture)
    error = (drawn.mean(0) - expected.mean) / expected.variance.sqrt()
    assert error.abs().max() < 5 / 200
    torch.testing.assert_close(drawn.var(0), expected.variance, rtol=0.05, atol=0.0)


def test_responsibilities_follow_bayes(mixture, weights):
    joint = torch.stack(
        [
            share * component.log_prob(weights).exp()
            for share, component in zip((0.75, 0.25), mixture.components, strict=True)
        ],
        dim=-1,
    )
    expected = joint / joint.sum(-1, keepdim=True)
    torch.testing.assert_close(mixture.responsibilities(weights), expected)


def paths(rng, centres, spread=0.1):
    """Return demonstrations that bend by the given amounts, each with a little noise."""
    phase = np.linspace(0.0, 1.0, 50)[:, None]
    return [
        np.hstack([phase, c * np.sin(np.pi * phase)])
        + spread * rng.standard_normal() * np.sin(2 * np.pi * phase)
        for c in centres
    ]


@pytest.mark.parametrize("seed", range(5))
def test_groups_are_found_as_they_were_made(seed):
    rng = np.random.default_rng(seed)
    groups = [-1.0, -1.0, 1.0, -1.0, 1.0, 1.0, 6.0, 6.0, 6.0]
    found = demonstrated_modes(paths(rng, groups))
    assert {frozenset(mode) for mode in found} == {
        frozenset({0, 1, 3}),
        frozenset({2, 4, 5}),
        frozenset({6, 7, 8}),
    }
    assert found[0][0] == 0


@pytest.mark.parametrize("seed", range(5))
def test_what_varies_evenly_is_one_group(seed):
    rng = np.random.default_rng(seed)
    phase = np.linspace(0.0, 1.0, 50)[:, None]
    bends = [
        sum(rng.standard_normal(2) * np.sin(n * np.pi * phase) for n in (1, 2, 3))
        for _ in range(14)
    ]
    assert len(demonstrated_modes(bends)) == 1
    assert len(demonstrated_modes(paths(rng, np.linspace(-1, 1, 14), spread=0.0))) == 1


def test_two_that_are_alike_are_a_mode_and_an_odd_one_or_equal_ones_are_none():
    rng = np.random.default_rng(0)
    assert demonstrated_modes(paths(rng, [0.0, 5.0, 0.0, 0.0, 5.0])) == ((0, 2, 3), (1, 4))
    assert len(demonstrated_modes(paths(rng, [0.0, 0.0, 0.0, 5.0]))) == 1
    assert len(demonstrated_modes(paths(rng, [0.0, 0.0, 0.0], spread=0.0))) == 1


def test_copies_are_no_modes():
    once = paths(np.random.default_rng(0), [0.0] * 4)
    assert len(demonstrated_modes([*once, *once])) == 1


@pytest.mark.parametrize("count", [7, 14])
def test_draws_of_one_gaussian_pass_for_modes_less_than_once_in_a_hundred(count):
    rng = np.random.default_rng(count)
    phase = np.linspace(0.0, 1.0, 20)[:, None]
    waves = np.concatenate([np.sin(np.pi * phase), np.sin(2 * np.pi * phase)], axis=1)
    # Two dimensions of equal spread in each of which a path may differ.
    drawn = rng.standard_normal((300, count, 2))
    found = [demonstrated_modes([(waves @ own)[:, None] for own in draw]) for draw in drawn]
    assert np.mean([len(groups) > 1 for groups in found]) < 0.01


def test_patterns_of_lasa_are_told_apart():
    """Three patterns of 3, 2 and 2 demonstrations, two of others, and one of a plain shape."""
    sizes = {
        shape: [len(group) for group in demonstrated_modes(lasa.demonstrations(shape))]
        for shape in lasa.shape_names()
    }
    assert sorted(sizes.pop("Multi_Models_1")) == [2, 2, 3]
    several = {name: sizes.pop(name) for name in list(sizes) if name.startswith("Multi_Models")}
    assert all(sorted(found) == [3, 4] for found in several.values())
    assert all(found == [7] for found in sizes.values())


def test_shipped_demonstrations_have_the_modes_of_their_task():
    placement = Demonstrations.load("Placement").configurations
    assert demonstrated_modes(placement) == (tuple(range(7)),)
    sides = Demonstrations.load("DoubleSidedPlacement").configurations
    assert demonstrated_modes(sides) == (tuple(range(7)), tuple(range(7, 14)))


def test_fit_learns_each_group_as_if_it_were_alone():
    demonstrations = paths(np.random.default_rng(0), [-1.0] * 6 + [1.0] * 3)
    mixture = ProMPMixture.fit(demonstrations, smooth_std=0.1)
    torch.testing.assert_close(mixture.shares, torch.tensor([6 / 9, 3 / 9]).double())
    alone = ProMP.fit(demonstrations[6:], smooth_std=0.1)
    torch.testing.assert_close(mixture.components[1].mean, alone.mean)
    torch.testing.assert_close(mixture.components[1].covariance, alone.covariance)


def test_fit_recovers_the_mixture_that_made_the_demonstrations():
    basis, noise = GaussianBasis(7), 0.02
    covariance = smooth_covariance(basis, 2, 0.1, 0.3)
    generator = torch.Generator().manual_seed(0)
    truths, demonstrations = [], []
    for count, bend in ((120, -1.0), (60, 1.0)):
        mean = torch.stack([torch.linspace(0, 1, 7), bend * torch.linspace(0, 3, 7).sin()], -1)
        truth = ProMP.from_covariance(
            basis, mean.double().flatten(), covariance, torch.full((2,), noise**2).double()
        )
        truths.append(truth)
        clean = truth.trajectory(truth.sample(count, generator), 40)
        shake = torch.randn(clean.shape, generator=generator, dtype=torch.float64)
        demonstrations += list(clean + noise * shake)
    found = ProMPMixture.fit(demonstrations, basis, smooth_std=0.0)
    torch.testing.assert_close(found.shares, torch.tensor([2 / 3, 1 / 3]).double())
    for component, truth, count in zip(found.components, truths, (120, 60), strict=True):
        path = truth.trajectory(component.mean - truth.mean, 40)
        assert path.abs().max() < 4 * 0.12 / count**0.5
        std = component.noise.diagonal().sqrt()
        torch.testing.assert_close(std, torch.full_like(std, noise), rtol=0.05, atol=0.0)
        design = torch.kron(basis.values(phases(40)), torch.eye(2, dtype=torch.float64))
        true, learned = (design @ c @ design.mT for c in (truth.covariance, component.covariance))
        relative = torch.linalg.matrix_norm(learned - true) / torch.linalg.matrix_norm(true)
        assert relative < 4 / count**0.5


def test_as_many_groups_are_made_as_are_asked_for():
    bends = paths(np.random.default_rng(0), [-1.0] * 4 + [1.0] * 4 + [1.5] * 4)
    with pytest.warns(UserWarning, match=r"fall into 3 groups, of 4, 4, 4; with modes=1 one"):
        assert demonstrated_modes(bends, modes=1) == (tuple(range(12)),)
    with pytest.warns(UserWarning, match="with modes=2 one"):
        assert demonstrated_modes(bends, modes=2) == (tuple(range(4)), tuple(range(4, 12)))
    three = tuple(tuple(range(a, a + 4)) for a in (0, 4, 8))
    assert demonstrated_modes(bends, modes=3) == three
    mixture = ProMPMixture.fit(bends, modes=4)
    assert len(mixture.components) == 4
    assert mixture.shares.min() >= 2 / 12


@pytest.mark.parametrize("modes", [0, -1, 4, 7, 100])
def test_modes_out_of_range_are_errors(modes):
    demonstrations = paths(np.random.default_rng(0), [0.0] * 7)
    message = f"modes must be 1 .. 3, as .* two demonstrations .* there are 7; got {modes}"
    with pytest.raises(ValueError, match=message):
        ProMPMixture.fit(demonstrations, modes=modes)


def test_demonstrations_that_do_not_divide_are_an_error():
    alone = paths(np.random.default_rng(0), [0.0, 0.0, 0.0, 9.0], spread=0.01)
    message = "modes must be less for these 4 demonstrations, .* groups of at least two; got 2"
    with pytest.raises(ValueError, match=message):
        ProMPMixture.fit(alone, modes=2)
    equal = paths(np.random.default_rng(0), [0.0] * 4, spread=0.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(ValueError, match=message):
            ProMPMixture.fit(equal, modes=2)


@pytest.mark.parametrize("learn", [demonstrated_modes, ProMPMixture.fit])
def test_demonstrations_that_are_none_are_errors(learn):
    good = paths(np.random.default_rng(0), [0.0, 1.0])
    with pytest.raises(ValueError, match=r"demonstrations\[2\] must have shape \(T, D\)"):
        learn([*good, good[0][:, 0]])
    with pytest.raises(ValueError, match="demonstrations must be at least 1, got 0"):
        learn([])


@pytest.mark.parametrize(
    ("count", "shares", "expected"),
    [(42, [0.5, 0.5], [21, 21]), (10, [2, 1], [7, 3]), (1, [0.4, 0.6], [0, 1]), (5, [1.0], [5])],
)
def test_particles_are_shared_out_in_full(count, shares, expected):
    assert shared_out(count, shares) == expected


@pytest.mark.parametrize(
    ("components", "shares", "message"),
    [
        ((), [], "at least one"),
        ((0, 1), [1.0], "2 positive numbers"),
        ((0, 1), [1.0, 0.0], "2 positive numbers"),
        ((0, 1), [1.0, np.nan], "2 positive numbers"),
    ],
)
def test_bad_mixtures_are_named(components, shares, message):
    with pytest.raises(ValueError, match=message):
        ProMPMixture(tuple(primitive(seed) for seed in components), torch.tensor(shares))


def test_components_must_agree_in_size():
    other = ProMP.fit(paths(np.random.default_rng(0), [0.0, 1.0]))
    with pytest.raises(ValueError, match="one size"):
        ProMPMixture((primitive(0), other), torch.ones(2))
