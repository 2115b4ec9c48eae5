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
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from smp_gym.arrays import FloatArray
from smp_planner.adaptation.runs import Runs, SceneCosts
from smp_planner.adaptation.stein import SteinSettings, affordable, inference_for
from smp_planner.inference import State, SVGDSettings, step
from smp_planner.inference.hamiltonian import Evaluated, hamiltonian_moves
from smp_planner.inference.resampling import effective_size, resampled, temperature_rise
from smp_planner.inference.svgd import LEAPFROGS

__all__ = ["FIRST_ANGLE", "JITTER", "tempered_stein"]

JITTER = 0.2
"""Share of fresh noise in a copy: z' = sqrt(1 - s²) z + s ξ, which keeps the prior as it is."""

FIRST_ANGLE = 0.08
"""Step, rad, with which Hamiltonian moves begin; each particle's own follows its acceptance."""


@dataclass(eq=False)
class _Part:
    """The particles (P_c, r_c) that share a prior, with their potential -log p(O|w)."""

    runs: Runs
    inference: SVGDSettings
    particles: FloatArray
    value: FloatArray
    gradient: FloatArray
    memory: Any = None

    @classmethod
    def of(cls, runs: Runs, latent: Tensor, inference: SVGDSettings) -> _Part:
        particles = latent.numpy()
        empty = np.empty(0)
        # The temperature is put into the score.
        part = cls(runs, replace(inference, annealing=0.0), particles, empty, empty)
        part.memory = inference.optimizer.init(latent[None])
        return part

    def paths(self, particles: FloatArray) -> FloatArray:
        """Return the trajectories (P, T, D) of whitened particles (P, r)."""
        return self.runs.latent_trajectories(torch.from_numpy(particles)[None])[0].numpy()

    def pulled_back(self, slope: FloatArray) -> FloatArray:
        """Return the gradient (P, r) by whitened particles of one (P, T, D) by trajectories."""
        return self.runs.latent_gradient(torch.from_numpy(slope)[None])[0].numpy()

    def descend(self, temperature: float, iteration: int) -> None:
        """Take one iteration of SVGD at a temperature."""
        particles = torch.from_numpy(self.particles)[None]
        score = torch.from_numpy(self.gradient)[None] * -temperature
        state = State(particles, self.memory, iteration)
        state = step(state, -particles, score, self.inference)
        self.particles, self.memory = state.particles[0].numpy(), state.memory

    def take(self, chosen: NDArray[np.intp], rng: np.random.Generator) -> None:
        """Keep the particles chosen, ascending; copies of one are set apart from it."""
        particles = self.particles[chosen]
        copies = np.flatnonzero(np.diff(chosen, prepend=-1) == 0)
        noise = rng.standard_normal((len(copies), particles.shape[1]))
        particles[copies] = math.sqrt(1.0 - JITTER**2) * particles[copies] + JITTER * noise
        self.particles, self.memory = particles, _taken(self.memory, chosen)


def _taken(memory: Any, chosen: NDArray[np.intp]) -> Any:
    """Return what an optimiser remembers of the particles chosen."""
    if isinstance(memory, Tensor):
        return memory[:, torch.from_numpy(chosen)]
    if isinstance(memory, tuple):
        return tuple(_taken(value, chosen) for value in memory)
    return memory


class _Population:
    """The particles of all parts, which compete; their costs are evaluated together."""

    def __init__(self, parts: Sequence[_Part], scene: SceneCosts, rng: np.random.Generator) -> None:
        self.parts, self.scene, self.rng = parts, scene, rng
        self.temperature = 0.0
        self._log_weights = np.zeros(sum(len(part.particles) for part in parts))

    @property
    def present(self) -> list[_Part]:
        """The parts that have particles."""
        return [part for part in self.parts if len(part.particles)]

    def choose(self, count: int) -> None:
        """Choose fewer of the draws, at the temperature at which so many are worth choosing."""
        paths = [part.paths(part.particles) for part in self.present]
        values = self.scene.weighted_sum(np.concatenate(paths))
        self.temperature = temperature_rise(-values, 1.0, count)
        self._resample(-self.temperature * values, count)

    def rise(self, temperature: float, effective_share: float) -> None:
        """Raise the temperature; resample where too few particles carry the weight."""
        if temperature <= self.temperature:
            return
        self._log_weights -= (temperature - self.temperature) * self._values()
        self.temperature = temperature
        count = len(self._log_weights)
        if effective_size(self._log_weights) < effective_share * count:
            self._resample(self._log_weights, count)
            self.evaluate()

    def evaluate(self) -> None:
        """Find the potential of all particles, and its gradient."""
        found = self._evaluated([part.particles for part in self.present])
        for part, (value, gradient) in zip(self.present, found, strict=True):
            part.value, part.gradient = value, gradient

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
            found = self._evaluated(apart(particles))
            values, gradients = zip(*found, strict=True)
            return np.concatenate(values), padded(gradients)

        moved, _ = hamiltonian_moves(
            Evaluated(
                padded([part.particles for part in parts]),
                self._values(),
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

    def _evaluated(self, particles: Sequence[FloatArray]) -> list[tuple[FloatArray, FloatArray]]:
        """Return -log p(O|w) (P_c,) of whitened particles (P_c, r_c) and its gradient, by parts."""
        parts = self.present
        paths = [part.paths(rows) for part, rows in zip(parts, particles, strict=True)]
        together = paths[0] if len(paths) == 1 else np.concatenate(paths)
        value, slope = self.scene.evaluate(together, 1.0)
        last = np.cumsum([len(rows) for rows in paths])[:-1]
        return [
            (of_part, part.pulled_back(of_paths))
            for part, of_part, of_paths in zip(
                parts, np.split(value, last), np.split(slope, last), strict=True
            )
        ]

    def _values(self) -> FloatArray:
        return np.concatenate([part.value for part in self.present])

    def _resample(self, log_weights: FloatArray, count: int) -> None:
        chosen = resampled(log_weights, count, self.rng)
        first = 0
        for part in self.present:
            last = first + len(part.particles)
            of_part = chosen[(chosen >= first) & (chosen < last)] - first
            part.take(of_part, self.rng)
            first = last
        self._log_weights = np.zeros(count)


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
    population = _Population(
        [
            _Part.of(run, draws, inference)
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
        for part in population.present:
            part.descend(population.temperature, iteration)
        iteration += 1
    if inference.moves and time.perf_counter() < until:
        population.move(inference.moves)
    return [torch.from_numpy(part.particles) for part in population.parts]
