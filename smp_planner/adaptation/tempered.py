"""Particles of all parts of a problem as one population, from the prior to the posterior.

SVGD moves particles and keeps all of them: what begins in a dead end stays in it, and the shares of
modes are those of the start. Here the likelihood's temperature rises from 0 to 1 while SVGD
follows it. With each rise particles are weighed by what it makes of them, across components and
branches of the prior, too, and resampled once few carry the weight: sequential Monte Carlo (Del
Moral, Doucet & Jasra 2006) with SVGD as its moves. Hamiltonian Monte Carlo at the end gives the set
the spread of the posterior.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from smp_gym.arrays import FloatArray
from smp_planner.adaptation.population import Members, Population
from smp_planner.adaptation.runs import Runs, SceneCosts
from smp_planner.adaptation.stein import SteinSettings, affordable, inference_for
from smp_planner.inference.hamiltonian import Evaluated, hamiltonian_moves
from smp_planner.inference.resampling import effective_size, resampled, temperature_rise
from smp_planner.inference.svgd import LEAPFROGS

__all__ = ["FIRST_ANGLE", "JITTER", "tempered_stein"]

JITTER = 0.2
"""Share of fresh noise in a copy: z' = sqrt(1 - s²) z + s ξ, which keeps the prior as it is."""

FIRST_ANGLE = 0.08
"""Step, rad, with which Hamiltonian moves begin; each particle's own follows its acceptance."""


class _Competition(Population):
    """A population whose particles are weighed and resampled as the temperature rises."""

    def __init__(
        self, parts: Sequence[Members], scene: SceneCosts, rng: np.random.Generator
    ) -> None:
        super().__init__(parts, scene)
        self.rng, self.temperature = rng, 0.0
        self._log_weights = np.zeros(sum(len(part.particles) for part in parts))

    def choose(self, count: int) -> None:
        """Choose fewer of the draws, at the temperature at which so many are worth choosing."""
        values = self.weighted_sums()
        self.temperature = temperature_rise(-values, 1.0, count)
        self._resample(-self.temperature * values, count)

    def rise(self, temperature: float, effective_share: float) -> None:
        """Raise the temperature; resample where too few particles carry the weight."""
        if temperature <= self.temperature:
            return
        self._log_weights -= (temperature - self.temperature) * self.values
        self.temperature = temperature
        count = len(self._log_weights)
        if effective_size(self._log_weights) < effective_share * count:
            copies = self._resample(self._log_weights, count)
            self.evaluate_some([copies[part] for part in self.present])

    def descend(self, iteration: int) -> None:
        """Take one iteration of SVGD at the present temperature."""
        for part in self.present:
            part.descend(self.temperature, iteration)

    def move(self, moves: int) -> None:
        """Move the particles by Hamiltonian Monte Carlo.

        Parts of a lower rank than the highest have further coordinates meanwhile, on which the
        potential does not depend: their flow is exact and changes no acceptance.
        """
        self.evaluate()
        parts = self.present
        ranks = [part.particles.shape[1] for part in parts]
        last = np.cumsum([len(part.particles) for part in parts])[:-1]

        def padded(arrays: Sequence[FloatArray]) -> FloatArray:
            return np.concatenate(
                [np.pad(each, ((0, 0), (0, max(ranks) - each.shape[1]))) for each in arrays]
            )

        def apart(particles: FloatArray) -> list[FloatArray]:
            return [
                np.ascontiguousarray(rows[:, :rank])
                for rows, rank in zip(np.split(particles, last), ranks, strict=True)
            ]

        def potential(particles: FloatArray) -> tuple[FloatArray, FloatArray]:
            values, gradients = zip(*self.evaluated(apart(particles)), strict=True)
            return np.concatenate(values), padded(gradients)

        moved, _ = hamiltonian_moves(
            Evaluated(
                padded([part.particles for part in parts]),
                self.values,
                padded([part.gradient for part in parts]),
            ),
            potential,
            self.rng,
            moves=moves,
            leapfrogs=LEAPFROGS,
            step=FIRST_ANGLE,
        )
        for part, particles in zip(parts, apart(moved.particles), strict=True):
            part.particles = particles

    def _resample(self, log_weights: FloatArray, count: int) -> dict[Members, NDArray[np.intp]]:
        """Resample all particles, and return the rows of those that are copies set apart."""
        chosen = resampled(log_weights, count, self.rng)
        first, copies = 0, {}
        for part in self.present:
            last = first + len(part.particles)
            own = chosen[(chosen >= first) & (chosen < last)] - first
            part.take(own)
            # Copies of one follow it, for the indices ascend.
            copies[part] = np.flatnonzero(np.diff(own, prepend=-1) == 0)
            noise = self.rng.standard_normal((len(copies[part]), part.particles.shape[1]))
            mother = part.particles[copies[part]]
            part.particles[copies[part]] = math.sqrt(1.0 - JITTER**2) * mother + JITTER * noise
            first = last
        self._log_weights = np.zeros(count)
        return copies


def tempered_stein(
    runs: Sequence[Runs],
    latent: Sequence[Tensor],
    scene: SceneCosts,
    rng: np.random.Generator,
    settings: SteinSettings,
    count: int,
    until: float = math.inf,
    record: Callable[[int, list[Tensor]], None] | None = None,
) -> list[Tensor]:
    """Return the particles of the parts of one problem after the last move.

    Where time runs short there are fewer iterations, as in `stein`, and no moves once it is over.

    Args:
        runs: the prior of each part, one run each.
        latent: of each part, draws (N_c, r_c) in whitened coordinates.
        scene: the costs.
        rng: source of all randomness.
        settings: of the run.
        count: P, particles of all parts together, at most ΣN_c.
        until: time of `time.perf_counter` by which to return.
        record: is told the particles of each part before each iteration, and its number; the first
            time those that were chosen of the draws. It must not change them.

    Returns:
        (P_c, r_c) of each part, P in sum; a part that no particle is left of has none.

    Raises:
        ValueError: a gradient is not finite.
    """
    inferences = [inference_for(run, settings) for run in runs]
    population = _Competition(
        [
            # The temperature is put into the score.
            Members.of(run, draws, replace(inference, annealing=0.0))
            for run, draws, inference in zip(runs, latent, inferences, strict=True)
        ],
        scene,
        rng,
    )
    inference = inferences[0]
    if sum(len(draws) for draws in latent) > count:
        population.choose(count)
    begin, iterations = time.perf_counter(), inference.iterations
    iteration = 0
    while iteration < iterations:
        fewer = affordable(iterations, iteration, begin, until)
        if fewer <= iteration:
            break
        if fewer < iterations:
            iterations = fewer
            for part in population.parts:
                part.inference = replace(part.inference, iterations=iterations)
        if record is not None:
            record(iteration, [torch.from_numpy(part.particles) for part in population.parts])
        population.evaluate()
        if inference.annealing > 0.0:
            temperature = inference.schedule(iteration, iterations, inference.annealing)
        else:
            temperature = 1.0
        population.rise(temperature, inference.resampling)
        population.descend(iteration)
        iteration += 1
    if inference.moves and time.perf_counter() < until:
        population.move(inference.moves)
    return [torch.from_numpy(part.particles) for part in population.parts]
