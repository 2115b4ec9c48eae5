"""A short run of scripts/attack.py: nothing wrong is accepted, and what is refused is named."""

import runpy
from collections import Counter
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[1] / "scripts" / "attack.py"


@pytest.mark.filterwarnings("ignore")
def test_bad_inputs_are_refused_by_name():
    told = []
    outcomes = runpy.run_path(str(SCRIPT))["attack"](250, 0, told.append)
    total = sum(outcomes.values(), Counter())
    assert total.total() == 250
    assert len(outcomes) > 30
    assert not {"accepted", "hung", "leaked", "memory"} & set(total), told
    assert total["unnamed"] <= 0.05 * 250, told
