"""Stein variational gradient descent as two pure functions, `init` and `step`.

Source: Liu & Wang 2016, Alg. 1; Eq. (5), (11) and (16). The indices of those equations are read as
usual: the sum runs over j, particle i is updated, and the repulsive gradient is with
respect to the summed particle, φ(x_i) = 1/P Σ_j [k(x_j, x_i) ∇ log p(x_j) + ∇_{x_j} k(x_j, x_i)].

A finite set has less spread than its target, the less the more dimensions and the fewer particles
there are, and in directions that the likelihood makes much narrower than the rest it may lose all
of it; means and modes are kept.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any, Literal, NamedTuple

import torch
from torch import Tensor

from smp_planner.inference.annealing import (
    Schedule,
    check_steps,
    cyclic_annealing,
    linear_decay,
    quadratic_annealing,
    tanh_annealing,
)
from smp_planner.inference.compiled import fits, median_rbf_direction
from smp_planner.inference.optimizers import AdaGrad, Adam, Optimizer
from smp_planner.inference.stein_kernels import (
    RBF,
    InverseMultiquadric,
    Kernel,
    MetricKernel,
    median_bandwidth,
    median_over_log_bandwidth,
)

__all__ = [
    "LEAPFROGS",
    "SETTINGS",
    "SVGDSettings",
    "State",
    "converged",
    "init",
    "named_settings",
    "stein_direction",
    "step",
]


LEAPFROGS = 5
"""Steps of the flow in one move of Hamiltonian Monte Carlo."""


class State(NamedTuple):
    """State of SVGD between two iterations.

    Attributes:
        particles: (..., P, d); leading dimensions are independent runs.
        memory: what the optimiser remembers.
        iteration: how many iterations are done.
    """

    particles: Tensor
    memory: Any
    iteration: int


@dataclass(frozen=True)
class SVGDSettings:
    """Settings of SVGD; the defaults are the *svgd* setting.

    Annealing follows D'Angelo & Fortuin (2021): the attractive term of the Stein direction is
    multiplied by the schedule and the repulsive term is not, so that particles spread before they
    settle. `annealed` says which part of the score is meant: all of it ("score", their reading), or
    the likelihood alone, which begins at the prior instead of at a flat target.

    Attributes:
        whiten: whether particles are the standard normals z of the weights (`ProMP.whiten`), which
            amounts to a constant matrix-valued kernel, or the weights themselves. The caller passes
            particles and scores in these coordinates; `step` does not use it.
        kernel: between particles.
        optimizer: turns the Stein direction into a change.
        step_size: of the first iteration.
        final_step: step size of the last iteration, as a fraction of the first.
        iterations: of a whole run.
        annealing: fraction of the run that is annealed; 0 for none.
        schedule: how the annealed part rises to its full size.
        annealed: the part of the score that is annealed.
        tolerance: mean movement of a particle in one iteration, root mean square over coordinates
            and in standard deviations of the prior, under which a run has converged; see
            `converged`.
        repulsion: whether particles see one another. Without, each climbs its own score: dropping
            only ∇k and keeping the average over particles would draw them all together.
        fading: whether they see one another less and less: of the direction a share that falls from
            1 to 0 over the run is Stein's, the rest the particle's own score. Repulsion finds ways
            that few particles take, but would send more there than the posterior has.
        overdraw: draws of the prior for each particle; those that begin are chosen among them by
            the likelihood, at the temperature at which so many are worth choosing.
        resampling: effective share of the particles below which they are resampled by their weights
            while the likelihood is annealed, as in sequential Monte Carlo; 0 never does.
        moves: of Hamiltonian Monte Carlo at the end, which leave the posterior as it is and give
            back the spread that a finite set lacks. It takes `LEAPFROGS` gradients for each.

    Raises:
        ValueError: a number is out of range, or `overdraw`, `resampling` or `moves` are asked for
            where particles are not whitened, or `resampling` where the likelihood is not annealed.
    """

    whiten: bool = True
    kernel: Kernel = field(default_factory=lambda: RBF(median_bandwidth))
    optimizer: Optimizer = field(default_factory=Adam)
    step_size: float = 0.2
    final_step: float = 0.1
    iterations: int = 100
    annealing: float = 0.7
    schedule: Schedule = tanh_annealing
    annealed: Literal["score", "likelihood"] = "score"
    tolerance: float = 0.01
    repulsion: bool = True
    fading: bool = False
    overdraw: int = 1
    resampling: float = 0.0
    moves: int = 0

    def __post_init__(self) -> None:
        check_steps(self.step_size, self.final_step, self.iterations)
        if not 0.0 <= self.annealing <= 1.0:
            raise ValueError(f"annealing must be in [0, 1], got {self.annealing}")
        if not (math.isfinite(self.tolerance) and self.tolerance > 0):
            raise ValueError(f"tolerance must be positive and finite, got {self.tolerance}")
        if self.annealed not in ("score", "likelihood"):
            raise ValueError(f"annealed must be 'score' or 'likelihood', got {self.annealed!r}")
        if self.overdraw < 1:
            raise ValueError(f"overdraw must be at least 1, got {self.overdraw}")
        if not 0.0 <= self.resampling < 1.0:
            raise ValueError(f"resampling must be in [0, 1), got {self.resampling}")
        if self.moves < 0:
            raise ValueError(f"moves must be at least 0, got {self.moves}")
        if self.competes and not self.whiten:
            raise ValueError("overdraw, resampling and moves need particles that are whitened")
        if (self.overdraw > 1 or self.resampling > 0.0) and self.annealed != "likelihood":
            raise ValueError("annealed must be 'likelihood' where particles are chosen by it")

    @property
    def competes(self) -> bool:
        """True if particles are chosen by their likelihood, or moved by more than a direction."""
        return self.overdraw > 1 or self.resampling > 0.0 or self.moves > 0

    @property
    def needs_metric(self) -> bool:
        """True if the kernel still lacks the metric in which it measures."""
        return isinstance(self.kernel, MetricKernel) and self.kernel.root is None

    def with_metric(self, root: Tensor) -> SVGDSettings:
        """Return the settings with the `root`, (m, d), of a `MetricKernel`.

        Raises:
            ValueError: the kernel is none, or `root` is not a finite matrix.
        """
        if not isinstance(self.kernel, MetricKernel):
            raise ValueError(f"kernel must be a MetricKernel to be given a metric: {self.kernel}")
        return replace(self, kernel=replace(self.kernel, root=root))


_SVGD = SVGDSettings()

_TEMPERED = SVGDSettings(
    optimizer=Adam(momentum=0.7, decay=0.9),
    step_size=0.35,
    iterations=50,
    schedule=quadratic_annealing,
    annealed="likelihood",
    overdraw=4,
    resampling=0.5,
    moves=4,
)

SETTINGS: Mapping[str, SVGDSettings] = MappingProxyType(
    {
        "svgd": _SVGD,
        "paper": SVGDSettings(
            whiten=False,
            kernel=RBF(median_over_log_bandwidth),
            optimizer=AdaGrad(),
            step_size=0.05,
            final_step=1.0,
            annealing=0.0,
        ),
        "quick": replace(
            _SVGD, optimizer=Adam(momentum=0.7, decay=0.9), step_size=0.35, iterations=50
        ),
        "tempered": _TEMPERED,
        "no_choice": replace(_TEMPERED, overdraw=1),
        "no_resampling": replace(_TEMPERED, resampling=0.0),
        "no_moves": replace(_TEMPERED, moves=0),
        "tempered_no_repulsion": replace(_TEMPERED, repulsion=False),
        "tempered_no_annealing": replace(_TEMPERED, annealing=0.0),
        "fading": replace(_TEMPERED, fading=True),
        "tempered_imq": replace(_TEMPERED, kernel=InverseMultiquadric()),
        "no_repulsion": replace(_SVGD, repulsion=False),
        "raw": replace(_SVGD, whiten=False),
        "median_over_log": replace(_SVGD, kernel=RBF(median_over_log_bandwidth)),
        "imq": replace(_SVGD, kernel=InverseMultiquadric()),
        "path_kernel": replace(_SVGD, kernel=MetricKernel()),
        "no_annealing": replace(_SVGD, annealing=0.0),
        "cyclic": replace(_SVGD, schedule=cyclic_annealing),
    }
)
"""The settings that are compared.

"tempered", the default of `smp`: particles as a population that competes on its path from the prior
to the posterior. Then the same without the choice among draws, without resampling, without the
moves at the end, without repulsion, without annealing, with repulsion that fades, and with the
inverse multi-quadric kernel.

"svgd": particles that do not compete, with an annealed score. "paper": as printed. "quick": "svgd"
in half as many iterations, with averages of fewer of them, so that what was learned of wide edges
of the map is forgotten, and longer steps. The rest is "svgd" with one thing changed: particles on
their own, raw weights, the paper's bandwidth, another kernel ("imq", or "path_kernel" of the
distance of paths, whose metric `SVGDSettings.with_metric` gives), no annealing, or cycles of it.
"""


def named_settings(name: str) -> SVGDSettings:
    """Return one of `SETTINGS`.

    Raises:
        ValueError: there is none of this name.
    """
    if name not in SETTINGS:
        raise ValueError(f"settings must be one of {', '.join(SETTINGS)}; got {name!r}")
    return SETTINGS[name]


def init(particles: Tensor, settings: SVGDSettings) -> State:
    """Return the state before the first iteration.

    Args:
        particles: (..., P, d), P at least 1, in the coordinates of `settings.whiten`.
        settings: of the run.

    Raises:
        ValueError: `particles` is not of that shape, or not finite.
    """
    if particles.ndim < 2 or 0 in particles.shape:
        raise ValueError(f"particles must have shape (..., P, d), got {tuple(particles.shape)}")
    _check_finite("particles", particles)
    return State(particles, settings.optimizer.init(particles), 0)


def stein_direction(
    particles: Tensor, score: Tensor, kernel: Kernel, attraction: float = 1.0
) -> Tensor:
    """Return the direction φ of Eq. (5), with the attractive term scaled.

    Args:
        particles: (..., P, d).
        score: (..., P, d) gradient of the log-target at the particles.
        kernel: between particles.
        attraction: factor of the attractive term.

    Returns:
        (..., P, d).
    """
    if isinstance(kernel, RBF) and kernel.bandwidth is median_bandwidth and fits(particles, score):
        return median_rbf_direction(particles, score, attraction)
    gram, repulsion = kernel(particles)
    return (attraction * (gram @ score) + repulsion) / particles.shape[-2]


def step(
    state: State,
    prior_score: Tensor,
    likelihood_score: Tensor,
    settings: SVGDSettings,
    *,
    validate: bool = True,
) -> State:
    """Return the state after one more iteration, Eq. (16) and Algorithm 1, lines 7 and 8.

    Args:
        state: before it.
        prior_score: (..., P, d) gradient of the log-prior at the particles.
        likelihood_score: (..., P, d) gradient of the log-likelihood, -λ ∇C.
        settings: the same as for `init`.
        validate: whether to check that scores are finite, for which a device has to be waited for;
            a caller who does not checks the particles in the end.

    Raises:
        ValueError: a score has another shape than the particles or is not finite, or all
            iterations are done.
    """
    particles = state.particles
    for name, score in (("prior_score", prior_score), ("likelihood_score", likelihood_score)):
        if score.shape != particles.shape:
            raise ValueError(
                f"{name} must have the shape {tuple(particles.shape)} of the particles, "
                f"got {tuple(score.shape)}"
            )
        if validate:
            _check_finite(name, score)
    temper = 1.0
    if settings.annealing > 0.0:
        temper = settings.schedule(state.iteration, settings.iterations, settings.annealing)
    if settings.annealed == "likelihood":
        score, attraction = torch.add(prior_score, likelihood_score, alpha=temper), 1.0
    else:
        score, attraction = prior_score + likelihood_score, temper
    if settings.repulsion:
        direction = stein_direction(particles, score, settings.kernel, attraction)
        if settings.fading:
            alone = state.iteration / settings.iterations
            direction = torch.lerp(direction, attraction * score, alone)
    else:
        direction = attraction * score
    change, memory = settings.optimizer.update(direction, state.memory, state.iteration)
    decay = linear_decay(state.iteration, settings.iterations, settings.final_step)
    moved = torch.add(particles, change, alpha=settings.step_size * decay)
    return State(moved, memory, state.iteration + 1)


def converged(state: State, movement: float, settings: SVGDSettings) -> bool:
    """Return whether a run may stop before all iterations are done: it is annealed and at rest.

    Args:
        state: after the last iteration.
        movement: mean over the particles of how far they went in it, root mean square over
            coordinates, in standard deviations of the prior.
        settings: of the run.
    """
    annealed = state.iteration >= settings.annealing * settings.iterations
    return annealed and movement < settings.tolerance


def _check_finite(name: str, value: Tensor) -> None:
    # The sum is finite only if every entry is, and is cheaper to check in the inner loop.
    if not math.isfinite(value.sum().item()):
        raise ValueError(f"{name} must be finite, got NaN or infinity")
