"""Left-out likelihood against a closed form and known widths; rows of rules."""

import numpy as np
import pytest
import torch
from scipy import stats

from smp_planner.experiments.prior_rules import (
    COLUMNS,
    RULES,
    RuleCell,
    leave_one_out,
    measure_rule,
)
from smp_planner.movement_primitives import GaussianBasis, ProMP
from smp_planner.planning.prior import learn_prior
from smp_planner.planning.settings import PriorSettings

SETTINGS = PriorSettings(smooth_std=0.3, basis_functions=8, modes=1)


def _paths(count, spread, seed=0):
    """Return draws of a primitive with a smooth covariance alone, and a little noise."""
    rng = np.random.default_rng(seed)
    phase = np.linspace(0.0, 1.0, 60)
    kernel = np.exp(-0.5 * ((phase[:, None] - phase) / 0.2) ** 2)
    root = np.linalg.cholesky(kernel + 1e-9 * np.eye(60))
    bends = spread * np.einsum("ts,nsd->ntd", root, rng.standard_normal((count, 60, 2)))
    return list(bends + 0.005 * rng.standard_normal((count, 60, 2)))


def test_it_is_the_density_of_each_under_the_others():
    """By scipy, of the whole path of one demonstration as a Gaussian of 2 x 60 numbers."""
    paths = _paths(5, 0.2)
    expected = []
    for index, left_out in enumerate(paths):
        learned = learn_prior([*paths[:index], *paths[index + 1 :]], SETTINGS).single
        values = learned.basis.values(torch.linspace(0.0, 1.0, 60, dtype=torch.float64))
        rows = np.kron(values.numpy(), np.eye(2))
        covariance = rows @ learned.covariance.numpy() @ rows.T
        covariance += np.kron(np.eye(60), learned.noise.numpy())
        mean = rows @ learned.mean.numpy()
        expected.append(stats.multivariate_normal(mean, covariance).logpdf(left_out.ravel()) / 120)
    assert leave_one_out(paths, SETTINGS, (1.0,)) == pytest.approx(np.mean(expected), rel=1e-6)


def test_a_mixture_of_equal_widths_is_the_width():
    paths = _paths(4, 0.2)
    assert leave_one_out(paths, SETTINGS, (1.0, 1.0)) == pytest.approx(
        leave_one_out(paths, SETTINGS, (1.0,)), rel=1e-9
    )


@pytest.mark.parametrize("spread", [0.05, 0.4])
def test_the_likeliest_width_is_about_that_of_the_demonstrations(spread):
    paths = _paths(12, spread, seed=3)
    factors = (0.03, 0.1, 0.3, 1.0, 3.0, 10.0)
    found = [leave_one_out(paths, SETTINGS, (factor,)) for factor in factors]
    best = SETTINGS.smooth_std * factors[int(np.argmax(found))]
    assert spread / 5.0 < best < 5.0 * spread


def test_the_t_is_wider_in_its_tails_than_a_gaussian():
    factors = np.array(RULES["Student-t"])
    assert (np.diff(factors) > 0.0).all()
    assert factors[0] < 1.0 < factors[-1]
    assert np.mean(factors**2) == pytest.approx(7.0 / 5.0, abs=0.2)


def test_rows_hold_what_the_table_shows():
    row = measure_rule(RuleCell("Placement", "as set and twice", "none", 79_005))
    assert {column.name for column in COLUMNS} | {"seed"} == row.keys()
    assert row["good"] > 90.0


def test_a_rule_of_the_present_width_plans_with_the_prior_as_it_is():
    basis = GaussianBasis(8)
    paths = _paths(5, 0.2)
    whole = learn_prior(paths, SETTINGS)
    narrow = learn_prior(paths, SETTINGS.model_copy(update={"smooth_std": 0.1}))
    widened = narrow.components(3.0)[0]
    assert isinstance(widened, ProMP)
    assert widened.basis == basis
    torch.testing.assert_close(widened.covariance, whole.single.covariance)
