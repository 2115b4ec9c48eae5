"""Optimisers as pure functions: from a direction of ascent to the change of the particles."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Protocol

import torch
from torch import Tensor

from smp_planner.inference.compiled import adam_change, fits

__all__ = ["AdaGrad", "Adam", "GradientAscent", "Optimizer"]


class Optimizer(Protocol):
    """Protocol of optimisers: directions to changes; the caller carries the state, a value."""

    def init(self, particles: Tensor) -> Any:
        """Return the state before the first iteration."""
        ...

    def update(self, direction: Tensor, memory: Any, iteration: int) -> tuple[Tensor, Any]:
        """Return the change for step size 1, same shape as `direction`, and the new memory."""
        ...


@dataclass(frozen=True)
class GradientAscent:
    """The direction itself, w ← w + ε φ (Algorithm 1, line 8)."""

    def init(self, particles: Tensor) -> None:
        """Return None: nothing is remembered."""

    def update(self, direction: Tensor, memory: None, iteration: int) -> tuple[Tensor, None]:
        """Return the direction unchanged."""
        return direction, None


@dataclass(frozen=True)
class AdaGrad:
    """AdaGrad with a moving average of squares, as Liu & Wang (2016) run SVGD.

    The average begins at the first squared direction, as in the experiments of that paper.

    Attributes:
        decay: of the moving average, in [0, 1).
        epsilon: keeps the division defined where a direction vanishes.
    """

    decay: float = 0.9
    epsilon: float = 1e-6

    def __post_init__(self) -> None:
        _check_decay("decay", self.decay)
        _check_positive("epsilon", self.epsilon)

    def init(self, particles: Tensor) -> Tensor:
        """Return the average of squares: zero."""
        return torch.zeros_like(particles)

    def update(self, direction: Tensor, memory: Tensor, iteration: int) -> tuple[Tensor, Tensor]:
        """Return the direction over its root mean square, and the new average of squares."""
        square = direction.square()
        average = square if iteration == 0 else torch.lerp(square, memory, self.decay)
        return direction / (average.sqrt() + self.epsilon), average


@dataclass(frozen=True)
class Adam:
    """Adam (Kingma & Ba 2015, Alg. 1).

    Attributes:
        momentum: β₁, in [0, 1).
        decay: β₂, in [0, 1).
        epsilon: keeps the division defined where a direction vanishes.
    """

    momentum: float = 0.9
    decay: float = 0.999
    epsilon: float = 1e-8

    def __post_init__(self) -> None:
        _check_decay("momentum", self.momentum)
        _check_decay("decay", self.decay)
        _check_positive("epsilon", self.epsilon)

    def init(self, particles: Tensor) -> tuple[Tensor, Tensor]:
        """Return the averages of directions and of squares: zero."""
        return torch.zeros_like(particles), torch.zeros_like(particles)

    def update(
        self, direction: Tensor, memory: tuple[Tensor, Tensor], iteration: int
    ) -> tuple[Tensor, tuple[Tensor, Tensor]]:
        """Return the mean direction over its root mean square, and the new averages."""
        if fits(direction, *memory):
            return adam_change(
                direction, memory, iteration + 1, self.momentum, self.decay, self.epsilon
            )
        first = torch.lerp(direction, memory[0], self.momentum)
        second = torch.lerp(direction.square(), memory[1], self.decay)
        mean = first / (1.0 - self.momentum ** (iteration + 1))
        square = second / (1.0 - self.decay ** (iteration + 1))
        return mean / (square.sqrt() + self.epsilon), (first, second)


def _check_decay(name: str, value: float) -> None:
    if not 0.0 <= value < 1.0:
        raise ValueError(f"{name} must be in [0, 1), got {value}")


def _check_positive(name: str, value: float) -> None:
    if not (math.isfinite(value) and value > 0):
        raise ValueError(f"{name} must be positive and finite, got {value}")
