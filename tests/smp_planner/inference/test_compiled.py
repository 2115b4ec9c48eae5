"""The compiled twins against the same arithmetic in torch, which single precision still takes."""

import pytest
import torch

from smp_planner.inference.compiled import MOST_PARTICLES, fits, median_rbf_direction
from smp_planner.inference.optimizers import Adam
from smp_planner.inference.stein_kernels import RBF, median_bandwidth
from smp_planner.inference.svgd import stein_direction


def normals(*shape, seed=0):
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(*shape, generator=generator, dtype=torch.float64)


def in_torch(particles, score, attraction):
    gram, repulsion = RBF(median_bandwidth)(particles)
    return (attraction * (gram @ score) + repulsion) / particles.shape[-2]


@pytest.mark.parametrize("shape", [(1, 3), (2, 5), (7, 1), (42, 84), (3, 9, 4), (2, 2, 6, 5)])
@pytest.mark.parametrize("attraction", [1.0, 0.25])
def test_the_direction_is_that_of_the_kernel_in_torch(shape, attraction):
    particles, score = normals(*shape), normals(*shape, seed=1)
    found = median_rbf_direction(particles, score, attraction)
    torch.testing.assert_close(found, in_torch(particles, score, attraction), atol=1e-12, rtol=1e-9)
    torch.testing.assert_close(
        stein_direction(particles, score, RBF(median_bandwidth), attraction),
        found,
        atol=0.0,
        rtol=0.0,
    )


def test_particles_that_coincide_have_a_finite_direction():
    particles = normals(1, 4).expand(5, 4).contiguous()
    score = normals(5, 4, seed=1)
    found = median_rbf_direction(particles, score, 1.0)
    torch.testing.assert_close(found, score.mean(0).expand(5, 4), atol=1e-12, rtol=1e-9)


@pytest.mark.parametrize("bandwidth", [0.7, lambda squared: median_bandwidth(squared) / 3.0])
def test_other_bandwidths_stay_in_torch(bandwidth):
    particles, score = normals(6, 3), normals(6, 3, seed=1)
    gram, repulsion = RBF(bandwidth)(particles)
    found = stein_direction(particles, score, RBF(bandwidth))
    torch.testing.assert_close(found, (gram @ score + repulsion) / 6, atol=0.0, rtol=0.0)
    assert not torch.allclose(found, median_rbf_direction(particles, score, 1.0))


def test_adam_walks_as_in_single_precision():
    optimizer = Adam(momentum=0.7, decay=0.9)
    memories = [
        optimizer.init(normals(2, 5, 3).to(kind)) for kind in (torch.float64, torch.float32)
    ]
    for iteration in range(12):
        direction = normals(2, 5, 3, seed=iteration)
        changes = []
        for index, kind in enumerate((torch.float64, torch.float32)):
            change, memories[index] = optimizer.update(
                direction.to(kind), memories[index], iteration
            )
            changes.append(change.double())
        torch.testing.assert_close(*changes, atol=1e-5, rtol=1e-4)
    assert memories[0][0].dtype == torch.float64


@pytest.mark.parametrize(
    "other",
    [
        normals(4, 3).float(),
        normals(3, 4).mT,
        normals(4, 3).requires_grad_(),
        normals(3),
        normals(MOST_PARTICLES + 1, 2),
    ],
    ids=["single", "transposed", "differentiated", "vector", "many"],
)
def test_what_does_not_fit_is_left_to_torch(other):
    assert fits(normals(4, 3))
    assert not fits(normals(4, 3), other)
