"""Draws of the posterior of a scene of the tasks, by sequential Monte Carlo.

p(w | good, start, goal), under the prior and the costs of `smp`: all components, branches and
widths of the prior are weighed by their evidence, and of the draws those are kept that the exact
check finds good.
"""

from __future__ import annotations

import numpy as np
import torch

from smp_gym.arrays import FloatArray
from smp_planner.adaptation import Runs
from smp_planner.inference.smc import SMCSettings, sample_posterior
from smp_planner.planning.assessment import assess
from smp_planner.planning.conditioning import Part, conditioned_parts
from smp_planner.planning.prior import Prior
from smp_planner.planning.problem import Problem
from smp_planner.planning.settings import PlanSettings
from smp_planner.planning.target import SceneTarget
from smp_planner.torch_threads import one_thread

__all__ = ["SMC", "posterior_draws"]

SMC = SMCSettings(particles=300, moves=10, last_moves=40)
"""Settings of the sampler, for each part of the prior."""


def posterior_draws(
    prior: Prior,
    problem: Problem,
    settings: PlanSettings,
    rng: np.random.Generator,
    smc: SMCSettings = SMC,
) -> FloatArray:
    """Return good draws (R, T, D) rad from the posterior of a problem.

    Args:
        prior: of a planner.
        problem: to be solved.
        settings: its costs, and the widths of the prior.
        rng: source of all randomness.
        smc: how to draw, for each part; R is at most the number of its particles.
    """
    with one_thread():
        target = SceneTarget(problem, settings)
        # As many particles as make a share of each part come out right.
        shares = settings.model_copy(update={"particles": 1000})
        parts = conditioned_parts(prior, problem, shares)
        latent, evidence = [], []
        for part in parts:
            draws, log_evidence = _part_draws(part, target, settings, rng, smc)
            latent.append(draws)
            evidence.append(np.log(len(part.latent)) + log_evidence)
        weights = np.exp(np.array(evidence) - max(evidence))
        counts = rng.multinomial(smc.particles, weights / weights.sum())
        drawn = []
        for part, draws, count in zip(parts, latent, counts, strict=True):
            chosen = torch.from_numpy(draws[rng.choice(len(draws), count, replace=False)])
            drawn.append(
                part.primitive.trajectory(part.primitive.unwhiten(chosen), settings.samples)
            )
        trajectories = torch.cat(drawn).numpy()
        return np.asarray(trajectories[assess(problem, trajectories, settings).good])


def _part_draws(
    part: Part,
    target: SceneTarget,
    settings: PlanSettings,
    rng: np.random.Generator,
    smc: SMCSettings,
) -> tuple[FloatArray, float]:
    """Return draws (R, r) of a part's posterior in whitened coordinates, and its log-evidence."""
    runs = Runs.of([part.primitive], settings.planning_steps)

    def log_likelihood(latent: FloatArray) -> FloatArray:
        paths = runs.latent_trajectories(torch.from_numpy(latent)[None])[0].numpy()
        return -target.weighted_sum(paths)

    found = sample_posterior(log_likelihood, part.primitive.rank, rng, smc)
    return found.particles, found.log_evidence
