"""Optimisers against torch's own and against the recursion written out."""

import pytest
import torch

from smp_planner.inference.optimizers import AdaGrad, Adam, GradientAscent


def _directions(count: int) -> list[torch.Tensor]:
    generator = torch.Generator().manual_seed(0)
    return [torch.randn(4, 3, generator=generator, dtype=torch.float64) for _ in range(count)]


def test_adam_walks_as_the_one_in_torch():
    parameter = torch.zeros(4, 3, dtype=torch.float64, requires_grad=True)
    reference = torch.optim.Adam([parameter], lr=0.05, maximize=True)
    optimizer = Adam()
    particles = torch.zeros(4, 3, dtype=torch.float64)
    memory = optimizer.init(particles)
    for iteration, direction in enumerate(_directions(20)):
        parameter.grad = direction.clone()
        reference.step()
        change, memory = optimizer.update(direction, memory, iteration)
        particles = particles + 0.05 * change
        torch.testing.assert_close(particles, parameter.detach(), atol=1e-12, rtol=1e-10)


def test_adagrad_divides_by_the_moving_root_mean_square():
    optimizer = AdaGrad(decay=0.8, epsilon=1e-9)
    directions = _directions(3)
    memory = optimizer.init(directions[0])
    for iteration, direction in enumerate(directions):
        change, memory = optimizer.update(direction, memory, iteration)
    a, b, c = (d.square() for d in directions)
    average = 0.64 * a + 0.16 * b + 0.2 * c
    torch.testing.assert_close(change, directions[2] / average.sqrt(), atol=1e-7, rtol=1e-7)


def test_gradient_ascent_takes_the_direction_as_it_is():
    (direction,) = _directions(1)
    change, _ = GradientAscent().update(direction, None, 0)
    assert torch.equal(change, direction)


@pytest.mark.parametrize(
    ("kind", "arguments", "message"),
    [
        (Adam, {"momentum": 1.0}, r"momentum must be in \[0, 1\), got 1.0"),
        (Adam, {"decay": -0.1}, r"decay must be in \[0, 1\)"),
        (Adam, {"epsilon": 0.0}, "epsilon must be positive"),
        (AdaGrad, {"decay": 1.5}, r"decay must be in \[0, 1\)"),
        (AdaGrad, {"epsilon": -1.0}, "epsilon must be positive"),
    ],
)
def test_bad_numbers_are_errors(kind, arguments, message):
    with pytest.raises(ValueError, match=message):
        kind(**arguments)
