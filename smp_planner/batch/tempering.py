"""Particles of a batch as populations that compete, from the prior to the posterior on one device.

It is what `smp_planner.adaptation.tempered` does, for B problems at once and without waiting for
the device: the temperature of a problem is a number on the device, and whether its particles are
resampled is decided there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from smp_planner.adaptation import Runs
from smp_planner.adaptation.tempered import FIRST_ANGLE, JITTER
from smp_planner.batch.descent import DeviceTarget
from smp_planner.inference import State, SVGDSettings, step
from smp_planner.inference.hamiltonian import Evaluated, hamiltonian_moves
from smp_planner.inference.svgd import LEAPFROGS

__all__ = ["Tempering", "effective_sizes", "resampled_rows", "temperature_rises"]

_TRIED = 32
_ROUNDS = 4
"""Temperatures that are tried at once, and how often the interval between two is divided so."""


def effective_sizes(log_weights: Tensor) -> Tensor:
    """Return the effective sample sizes (...) of log-weights (..., P), each in [1, P]."""
    twice = torch.logsumexp(2.0 * log_weights, -1)
    return torch.exp(2.0 * torch.logsumexp(log_weights, -1) - twice)


def temperature_rises(log_likelihood: Tensor, effective: float) -> Tensor:
    """Return by how much temperatures (B,) may rise from 0, at most to 1.

    Args:
        log_likelihood: (B, P) of particles of equal weight.
        effective: sample size that each rise has to leave, less than P.
    """
    low = torch.zeros_like(log_likelihood[:, 0])
    width = torch.ones_like(low)
    shares = torch.arange(1, _TRIED + 1, device=low.device, dtype=low.dtype) / _TRIED
    for _ in range(_ROUNDS):
        tried = low[:, None] + width[:, None] * shares
        sizes = effective_sizes(tried[..., None] * log_likelihood[:, None])
        # The sizes fall with the temperature: the rise is beyond those that leave enough.
        enough = (sizes >= effective).to(low.dtype).cumprod(-1).sum(-1)
        low = low + width * enough / _TRIED
        width = width / _TRIED
    return low.clamp_max(1.0)


def resampled_rows(log_weights: Tensor, count: int, draws: Tensor) -> Tensor:
    """Return the ascending indices (B, count) that systematic resampling chooses.

    Args:
        log_weights: (B, P), of any sums.
        count: how many are chosen of each row.
        draws: (B, 1), uniform in [0, 1).
    """
    weights = torch.softmax(log_weights, -1).cumsum(-1)
    steps = torch.arange(count, device=draws.device, dtype=draws.dtype)
    positions = ((draws + steps) / count).contiguous()
    found = torch.searchsorted(weights.contiguous(), positions)
    return found.clamp_max(log_weights.shape[-1] - 1)


@dataclass(frozen=True)
class _Draws:
    """Randomness on a device, as `hamiltonian_moves` asks for it."""

    generator: torch.Generator
    dtype: torch.dtype

    def standard_normal(self, size: tuple[int, ...]) -> Tensor:
        """Return standard normal numbers."""
        return torch.randn(
            size, generator=self.generator, dtype=self.dtype, device=self.generator.device
        )

    def uniform(self, low: float, high: float, size: tuple[int, ...]) -> Tensor:
        """Return numbers in [low, high)."""
        drawn = torch.rand(
            size, generator=self.generator, dtype=self.dtype, device=self.generator.device
        )
        return low + (high - low) * drawn


@dataclass(frozen=True)
class Tempering:
    """A run of particles that compete, as a function that a graph can record.

    Attributes:
        inference: settings that whiten, with the number of iterations.
        count: P, how many of the draws become particles.
    """

    inference: SVGDSettings
    count: int

    def shortened(self, iterations: int) -> Tempering:
        """Return a run of few iterations, which calls all that the whole one calls."""
        fewer = min(iterations, self.inference.iterations)
        moves = min(1, self.inference.moves)
        return replace(self, inference=replace(self.inference, iterations=fewer, moves=moves))

    def __call__(
        self, runs: Runs, latent: Tensor, target: DeviceTarget, generator: torch.Generator
    ) -> Tensor:
        """Return particles (B, P, r) after the last move.

        Args:
            runs: the priors.
            latent: (B, N, r) draws in whitened coordinates, N at least P.
            target: the costs.
            generator: source of all randomness, on the particles' device.
        """
        draws = _Draws(generator, latent.dtype)
        population = _Population.chosen(runs, latent, target, self.count, draws)
        inference = replace(self.inference, annealing=0.0)
        before = 0.0
        for iteration in range(inference.iterations):
            temperature = self._temperature(iteration)
            if before < 1.0:
                population.rise(temperature, inference.resampling)
            before = temperature
            population.descend(iteration, inference)
        if inference.moves:
            population.move(inference.moves)
        return population.particles

    def _temperature(self, iteration: int) -> float:
        if self.inference.annealing <= 0.0:
            return 1.0
        return self.inference.schedule(
            iteration, self.inference.iterations, self.inference.annealing
        )


@dataclass(eq=False)
class _Population:
    """The particles (B, P, r) of B problems with their temperatures (B, 1)."""

    runs: Runs
    target: DeviceTarget
    draws: _Draws
    particles: Tensor
    temperature: Tensor
    log_weights: Tensor
    memory: Any = None

    @classmethod
    def chosen(
        cls, runs: Runs, latent: Tensor, target: DeviceTarget, count: int, draws: _Draws
    ) -> _Population:
        """Return the population of P of the draws (B, N, r).

        They are chosen at the temperature at which so many are worth choosing.
        """
        zero = latent.new_zeros((len(latent), 1))
        if count == latent.shape[1]:
            return cls(runs, target, draws, latent, zero, zero.expand(-1, count))
        values = target.weighted_sum(runs.latent_trajectories(latent).contiguous())
        temperature = temperature_rises(-values, float(count))[:, None]
        rows = resampled_rows(-temperature * values, count, draws.uniform(0.0, 1.0, zero.shape))
        found = cls(runs, target, draws, latent, temperature, zero.expand(-1, count))
        found._take(rows, torch.ones_like(zero, dtype=torch.bool))
        return found

    def rise(self, temperature: float, effective_share: float) -> None:
        """Raise the temperatures; resample where too few particles carry the weight."""
        count = self.particles.shape[1]
        values = self.target.weighted_sum(self._paths())
        risen = self.temperature.clamp_min(temperature)
        self.log_weights = self.log_weights - (risen - self.temperature) * values
        self.temperature = risen
        few = (effective_sizes(self.log_weights) < effective_share * count)[:, None]
        rows = resampled_rows(
            self.log_weights, count, self.draws.uniform(0.0, 1.0, self.temperature.shape)
        )
        self._take(torch.where(few, rows, torch.arange(count, device=rows.device)), few)
        self.log_weights = torch.where(few, 0.0, self.log_weights)

    def descend(self, iteration: int, inference: SVGDSettings) -> None:
        """Take one iteration of SVGD at the temperatures."""
        if self.memory is None:
            self.memory = inference.optimizer.init(self.particles)
        gradient = self.runs.latent_gradient(self.target.gradient(self._paths(), 1.0))
        score = -self.temperature[..., None] * gradient
        state = State(self.particles, self.memory, iteration)
        state = step(state, -self.particles, score, inference, validate=False)
        self.particles, self.memory = state.particles, state.memory

    def move(self, moves: int) -> None:
        """Move the particles by Hamiltonian Monte Carlo."""

        def potential(particles: Tensor) -> tuple[Tensor, Tensor]:
            paths = self.runs.latent_trajectories(particles).contiguous()
            gradient = self.runs.latent_gradient(self.target.gradient(paths, 1.0))
            return self.target.weighted_sum(paths), gradient

        moved, _ = hamiltonian_moves(
            Evaluated(self.particles, *potential(self.particles)),
            potential,
            self.draws,
            moves=moves,
            leapfrogs=LEAPFROGS,
            step=FIRST_ANGLE,
        )
        self.particles = moved.particles

    def _paths(self) -> Tensor:
        return self.runs.latent_trajectories(self.particles).contiguous()

    def _take(self, rows: Tensor, anew: Tensor) -> None:
        """Keep the particles of rows (B, P), ascending; copies of one are set apart from it.

        Where nothing is drawn anew, (B, 1), rows are all of them.
        """
        particles = _taken(self.particles, rows)
        copies = (rows.diff(dim=-1, prepend=torch.full_like(rows[:, :1], -1)) == 0) & anew
        noise = self.draws.standard_normal(particles.shape)
        apart = math.sqrt(1.0 - JITTER**2) * particles + JITTER * noise
        self.particles = torch.where(copies[..., None], apart, particles)
        if self.memory is not None:
            self.memory = _all_taken(self.memory, rows)


def _taken(values: Tensor, rows: Tensor) -> Tensor:
    return values.gather(1, rows[..., None].expand(-1, -1, values.shape[-1]))


def _all_taken(memory: Any, rows: Tensor) -> Any:
    """Return what an optimiser remembers of the particles chosen."""
    if isinstance(memory, Tensor):
        return _taken(memory, rows)
    if isinstance(memory, tuple):
        return tuple(_all_taken(value, rows) for value in memory)
    return memory
