"""Costs of the user's own: one function in torch, for every path of planning."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import torch
from numpy.typing import ArrayLike
from torch import Tensor

from smp_planner.collision.costs import ValueAndGradient, check_trajectories

__all__ = ["OwnCost", "OwnCosts", "checked_own_costs"]


@dataclass(frozen=True)
class OwnCost:
    """A cost of the user's own, its gradient by autograd.

    Attributes:
        function: from configurations (..., T, D), rad (or extents), at equal steps of phase, to the
            cost (...) of each trajectory; differentiable, of trajectories that do not see one
            another. On a GPU it must not wait for the device, as ``.item()`` or an ``if`` on a
            tensor does.
    """

    function: Callable[[Tensor], Tensor]

    def __call__(self, trajectories: ArrayLike) -> ValueAndGradient:
        """Return the value (P,) and the gradient (P, T, D) of trajectories (P, T, D).

        Raises:
            ValueError: the trajectories are not of that shape or not finite, or see `evaluate`.
        """
        value, gradient = self.evaluate(torch.from_numpy(check_trajectories(trajectories)))
        return value.numpy(), gradient.numpy()

    def evaluate(self, trajectories: Tensor) -> tuple[Tensor, Tensor]:
        """Return the value (...) and the gradient (..., T, D) of trajectories (..., T, D).

        Raises:
            ValueError: the function returns another shape, or nothing that depends on them.
        """
        given = trajectories.detach().requires_grad_()
        with torch.enable_grad():
            value = self.function(given)
            if not isinstance(value, Tensor) or value.shape != given.shape[:-2]:
                got = tuple(value.shape) if isinstance(value, Tensor) else type(value).__name__
                raise ValueError(
                    f"a cost of one's own must return a tensor of shape {tuple(given.shape[:-2])} "
                    f"for trajectories of shape {tuple(given.shape)}, got {got}"
                )
            if not value.requires_grad:
                raise ValueError("a cost of one's own must depend on the trajectories by torch")
            (gradient,) = torch.autograd.grad(value.sum(), given)
        return value.detach(), gradient


OwnCosts = Mapping[str, tuple[float, Callable[[Tensor], Tensor]]]
"""Costs of one's own by name: weight, and the function of `OwnCost`."""


def checked_own_costs(costs: OwnCosts | None) -> dict[str, tuple[float, OwnCost]]:
    """Return costs of one's own as costs.

    Raises:
        ValueError: a weight is not positive and finite.
    """
    checked = {}
    for name, (weight, function) in (costs or {}).items():
        if not (math.isfinite(weight) and weight > 0.0):
            raise ValueError(f"the weight of cost {name!r} must be positive, got {weight}")
        checked[name] = float(weight), OwnCost(function)
    return checked
