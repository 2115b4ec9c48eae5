"""Feasible references in the physics: those of sampling solve their scenes, others do not."""

import pytest

from smp_gym.inspection import witness_check
from smp_gym.inspection.witness_check import witness_solves


@pytest.mark.parametrize("task", ["Placement", "DrawS"])
def test_a_witness_solves_its_scene(task):
    assert witness_solves((task, "hard", 2)) is True


def test_a_witness_that_stays_where_it_starts_solves_nothing(monkeypatch):
    sample = witness_check.sample_with_witness

    def still(task, difficulty, seed):
        scene, witness = sample(task, difficulty, seed)
        return scene, witness[:1].repeat(len(witness), axis=0)

    monkeypatch.setattr(witness_check, "sample_with_witness", still)
    assert witness_solves(("Placement", "easy", 2)) is False
