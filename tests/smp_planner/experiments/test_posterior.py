"""The exact posterior of a LASA scene, and the rows of settings that are held against it."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.special import logsumexp

from smp_planner.experiments import lasa_posterior
from smp_planner.experiments.comparison import common_ends
from smp_planner.experiments.lasa_scenes import FIGURE_1, FIGURE_2B, learn, settings
from smp_planner.experiments.paths import classes
from smp_planner.experiments.posterior import Reference, columns, exact_draws, posterior_row
from smp_planner.experiments.tables import summarise
from smp_planner.inference.smc import SMCSettings
from smp_planner.library.smp import SMP

COARSE = settings().model_copy(update={"samples": 50})
FEW = SMCSettings(particles=600, moves=10, last_moves=10)


@pytest.fixture(scope="module")
def primitive() -> SMP:
    return learn("Sshape")


def test_weights_of_classes_agree_with_importance_sampling(primitive: SMP) -> None:
    drawn = exact_draws(primitive, FIGURE_1, COARSE, np.random.default_rng(0), FEW)
    ends = common_ends(primitive)
    found = classes(drawn, FIGURE_1.obstacles, ends)

    # Prior draws, weighed by their likelihood, from the formula of Eq. (12).
    prior = primitive.mixture.components[0]
    prior = prior.condition(1.0, torch.from_numpy(primitive.frame.inwards((0.0, 0.0))))
    weights = prior.sample(20_000, torch.Generator().manual_seed(1))
    paths = primitive.frame.outwards(prior.trajectory(weights, 50).numpy())
    cost = np.zeros(len(paths))
    margin, width = (primitive.extent * share for share in (COARSE.margin, COARSE.edge_width[1]))
    gaps = [np.linalg.norm(paths - c.center, axis=-1) - c.radius for c in FIGURE_1.obstacles]
    occupancy = 1.0 / (1.0 + np.exp((np.min(gaps, axis=0) - margin) / width))
    cost = COARSE.obstacle_weight * np.square(occupancy).sum(axis=1)
    share = np.exp(-cost - logsumexp(-cost))
    assert 1.0 / np.square(share).sum() > 500
    signatures = classes(paths, FIGURE_1.obstacles, ends)
    for signature in np.unique(signatures, axis=0):
        expected = share[(signatures == signature).all(axis=1)].sum()
        assert (found == signature).all(axis=1).mean() == pytest.approx(expected, abs=0.08)
    assert np.linalg.norm(drawn[:, -1], axis=-1).max() < 1e-6
    mean = np.einsum("p,ptd->td", share, paths)
    assert np.abs(drawn.mean(axis=0) - mean).max() < 1.0


def test_scenes_without_an_exact_posterior(primitive: SMP) -> None:
    rng = np.random.default_rng(0)
    with pytest.raises(ValueError, match="got 1 components, 0 obstacles and 0 via-points"):
        exact_draws(primitive, replace(FIGURE_1, obstacles=()), COARSE, rng)
    with pytest.raises(ValueError, match="got 2 components"):
        exact_draws(learn("Sshape+WShape"), FIGURE_2B, COARSE, rng)


def test_a_set_against_itself(primitive: SMP) -> None:
    paths = primitive.adapt(particles=100, method="promp").trajectories
    signatures = classes(paths, FIGURE_1.obstacles, common_ends(primitive))
    reference = Reference(paths, signatures)
    row = posterior_row("itself", paths, signatures, reference, FIGURE_1)
    assert row["variation"] == 0.0
    assert row["wasserstein_exact"] == pytest.approx(0.0, abs=1e-6)
    assert row["diversity"] == row["spread"] == pytest.approx(1.0)
    weights = [row[f"class_{n}"] for n in range(1, len(reference.classes) + 1)]
    assert sum(weights) == pytest.approx(1.0)
    assert weights == sorted(weights, reverse=True)
    assert {column.name for column in columns(reference)} <= row.keys()


def test_rows_of_settings() -> None:
    ground = lasa_posterior.Ground.of(
        lasa_posterior.VARIANTS["fig1"], 2, SMCSettings(50, moves=2, last_moves=2)
    )
    ground = replace(ground, prior=ground.prior[::20])
    names = [lasa_posterior.EXACT, "svgd", "no_repulsion"]
    rows = [*ground.reference_rows(), *(ground.row(name, 12, 3) for name in names)]
    assert rows[3] == ground.row("svgd", 12, 3)
    summaries = summarise(rows, ["setting"])
    assert [s["setting"] for s in summaries] == [lasa_posterior.POSTERIOR, *names]
    for column in lasa_posterior.settings_columns(ground):
        assert column.text(summaries[1][column.name])
    # Particles on their own all climb to the top of their class.
    assert rows[4]["spread"] < 0.2 < rows[3]["spread"]
