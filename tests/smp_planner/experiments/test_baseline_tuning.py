"""The search of settings: what is tried, how it is judged, and how it is ranked."""

from types import SimpleNamespace

import numpy as np
import pytest
from rich.console import Console

from smp_planner.experiments import baseline_tuning
from smp_planner.experiments.baseline_tuning import (
    CANDIDATES,
    Cell,
    Trial,
    candidates,
    cells_of,
    trial,
    trials_table,
)
from smp_planner.policy.planner_policy import PlannerPolicy


@pytest.mark.parametrize("task", ["Placement", "DrawS"])
@pytest.mark.parametrize("method", CANDIDATES)
def test_every_candidate_is_a_setting_that_its_method_knows(task, method):
    for settings in candidates(task, method):
        found = PlannerPolicy.make(method, task, settings=settings).planner.settings
        for name, value in settings.items():
            assert found[name] == value


def test_strokes_have_candidates_of_their_own():
    seeds = range(3)
    cells = cells_of(["Placement", "DrawS"], ["cpromp"], "medium", seeds)
    assert [cell.task for cell in cells].count("DrawS") == len(CANDIDATES["cpromp"]) + 3
    assert cells[0] == Cell("Placement", "cpromp", {}, "medium", seeds)


def test_a_trial_counts_particles_that_are_good_and_reach_the_goal(monkeypatch):
    plans = iter(
        SimpleNamespace(
            good=np.array(good),
            collision_free=np.array(free),
        )
        for good, free in (
            ([True, False, False, True], [True, True, True, True]),
            ([False, False], [True, False]),
        )
    )

    class Policy:
        def predict(self, observation, deterministic):
            assert deterministic
            return None, (SimpleNamespace(plan=next(plans)),)

    def make(method, task, settings):
        assert (method, task, settings) == ("cpromp", "Placement", {"margin": 0.02})
        return Policy()

    monkeypatch.setattr(baseline_tuning, "PlannerPolicy", SimpleNamespace(make=make))
    found = trial(Cell("Placement", "cpromp", {"margin": 0.02}, "none", range(2)))
    assert found == Trial(solved=1, share=0.25, free=0.75)


def test_the_best_of_each_method_stands_first():
    cells = [
        Cell("Placement", "cpromp", {}, "easy", range(4)),
        Cell("Placement", "cpromp", {"margin": 0.02}, "easy", range(4)),
        Cell("Placement", "prompt_o", {"rounds": 16}, "easy", range(4)),
    ]
    trials = [Trial(1, 0.1, 0.2), Trial(3, 0.5, 0.6), Trial(4, 0.9, 1.0)]
    console = Console(width=120)
    with console.capture() as shown:
        console.print(trials_table(cells, trials))
    rows = [line for line in shown.get().splitlines() if "Placement" in line]
    assert ["margin 0.02" in rows[0], "as now" in rows[1], "rounds 16" in rows[2]] == [True] * 3
    assert "3 of 4" in rows[0]
    assert "50.0%" in rows[0]
