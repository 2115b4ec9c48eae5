"""Blending and co-activation of primitives: one primitive that is the product of several."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from smp_planner.movement_primitives.basis import phases
from smp_planner.movement_primitives.promp import ProMP

__all__ = ["blend"]

_CERTAIN_SHARE = 1e-6
"""Standard deviation, over the largest of the primitive, under which its precision is lost to
rounding."""


def blend(primitives: Sequence[ProMP], activations: Tensor) -> ProMP:
    """Return the primitive whose positions are the product of those of several, at every phase.

    At phase t that is Π_i N(y; μ_it, Σ_it)^α_it up to its scale: a Gaussian with precision
    Σ_i α_it Σ_it⁻¹, in which each mean has the share of its precision (Paraschos et al. 2013; here
    for positions). A product at each phase does not say how phases covary. Here trajectories are
    made of those of the primitives, y_t = μ_t + Σ_t Σ_i √α_it Σ_it⁻¹ (y_it - μ_it) with an
    independent draw of each: they have that mean and covariance at every phase, and where no other
    is active they are those of the one that is.

    The weights are the least-squares fit to these trajectories at the phases of the activations, so
    the product is met as far as the basis can follow it: if it changes within less than about two
    spacings of basis functions, as where an activation is switched, the change is smoothed.

    Activations that sum to 1 blend from one primitive to another; two that are both 1 demand both
    at once. The observation noise is that of the product at the mean activations.

    Args:
        primitives: N over one basis, of one dimension; leading dimensions of means broadcast.
        activations: (N, T) α at T equally spaced phases from 0 to 1, not negative, at least one
            positive at each phase; T at least the number of basis functions.

    Raises:
        ValueError: primitives do not fit together, `activations` is not as above, or a position is
            certain under a primitive at a phase where another is active, too (blend first, then
            condition).
    """
    active = _checked_activations(primitives, activations)
    first = primitives[0]
    at = phases(active.shape[1], dtype=active.dtype, device=active.device)
    values = first.basis.values(at)
    identity = torch.eye(first.dimension, dtype=active.dtype, device=active.device)

    # Where one is active alone its precision is not asked for, so there it may be certain.
    alone = (active > 0) & ((active > 0).sum(0) == 1)
    deviations = [
        torch.einsum("tk,kdr->tdr", values, p.factor.unflatten(0, (-1, p.dimension)))
        for p in primitives
    ]
    precisions = torch.stack(
        [
            identity * only[:, None, None] + _precisions(deviation, a * ~only, index, at)
            for index, (deviation, a, only) in enumerate(
                zip(deviations, active, alone, strict=True)
            )
        ]
    )
    shares = torch.linalg.solve(precisions.sum(0), precisions)
    gains = shares / torch.where(active > 0, active, 1.0).sqrt()[..., None, None]

    paths = [p.trajectory(p.mean, at) for p in primitives]
    path = sum(torch.einsum("tab,...tb->...ta", s, y) for s, y in zip(shares, paths, strict=True))
    factor = torch.cat([g @ d for g, d in zip(gains, deviations, strict=True)], -1)
    fit = torch.linalg.pinv(values)
    noise_precision = sum(
        a * torch.linalg.inv(p.noise) for a, p in zip(active.mean(1), primitives, strict=True)
    )
    return ProMP(
        first.basis,
        (fit @ path).flatten(-2),
        torch.einsum("kt,tdr->kdr", fit, factor).flatten(0, 1),
        torch.linalg.inv(noise_precision),
    )


def _precisions(deviation: Tensor, activation: Tensor, index: int, at: Tensor) -> Tensor:
    """Return α Σ⁻¹ (T, D, D) of one primitive from its factor at the phases, (T, D, r)."""
    active = activation > 0
    covariance = deviation @ deviation.mT
    variances = torch.linalg.eigvalsh(covariance)
    certain = active & (variances[:, 0] <= _CERTAIN_SHARE**2 * variances.max())
    if bool(certain.any()):
        raise ValueError(
            f"primitives[{index}] is certain at phase {float(at[certain][0]):.3g}, where another "
            "is active, too: blend before exact conditioning"
        )
    identity = torch.eye(covariance.shape[-1]).to(covariance)
    covariance = torch.where(active[:, None, None], covariance, identity)
    return activation[:, None, None] * torch.linalg.inv(covariance)


def _checked_activations(primitives: Sequence[ProMP], activations: Tensor) -> Tensor:
    """Return the activations (N, T), scaled as the primitives are, after all checks."""
    if not primitives:
        raise ValueError("primitives must hold at least one, got none")
    first = primitives[0]
    for index, primitive in enumerate(primitives):
        if (primitive.basis, primitive.dimension) != (first.basis, first.dimension):
            raise ValueError(
                f"primitives must have one basis and dimension: primitives[{index}] has "
                f"{primitive.basis} and {primitive.dimension}, primitives[0] has {first.basis} and "
                f"{first.dimension}"
            )
    checked = torch.as_tensor(activations, dtype=first.mean.dtype, device=first.mean.device)
    fewest = first.basis.count
    if checked.ndim != 2 or len(checked) != len(primitives) or checked.shape[1] < fewest:
        raise ValueError(
            f"activations must have shape ({len(primitives)}, T) with T of at least {fewest}, "
            f"got {tuple(checked.shape)}"
        )
    if not bool((torch.isfinite(checked) & (checked >= 0)).all()):
        raise ValueError("activations must be finite and not negative")
    if not bool((checked > 0).any(0).all()):
        sample = int((~(checked > 0).any(0)).nonzero()[0])
        raise ValueError(f"activations must not all be zero at one phase, as at sample {sample}")
    return checked
