"""Settings of all kinds take numbers for numbers, and what JSON brings."""

import numpy as np
import pytest

from smp_planner.adaptation.chance_constrained import ChanceSettings
from smp_planner.adaptation.stein import SteinSettings
from smp_planner.agents.bump_training import BumpSettings
from smp_planner.planners.rrt_connect.planner import RRTConnectSettings
from smp_planner.planning.settings import PlanSettings, PriorSettings


@pytest.mark.parametrize(
    ("model", "name", "value"),
    [
        (PriorSettings, "basis_functions", "8"),
        (PriorSettings, "smooth_std", True),
        (PriorSettings, "smooth_std", (0.1, "0.2")),
        (PriorSettings, "modes", "2"),
        (PriorSettings, "nan_is_missing", "no"),
        (PlanSettings, "particles", True),
        (PlanSettings, "edge_width", ("0.05", 0.01)),
        (PlanSettings, "margin", np.True_),
        (SteinSettings, "step_size", "0.2"),
        (SteinSettings, "iterations", False),
        (ChanceSettings, "risk", "0.1"),
        (RRTConnectSettings, "postures", "64"),
        (BumpSettings, "learning_rate", True),
    ],
)
def test_text_and_truth_values_are_no_numbers(model, name, value):
    assert name in model.model_fields
    with pytest.raises(
        ValueError, match=rf"{name} must be (a number or numbers|True or False), got"
    ):
        model(**{name: value})


@pytest.mark.parametrize(
    ("model", "given"),
    [
        (PriorSettings, {"basis_functions": np.int64(20), "smooth_std": [0.1, 0.2], "modes": None}),
        (PriorSettings, {"nan_is_missing": True, "smooth_std": np.float32(0.5)}),
        (PlanSettings, {"map": "exact", "widths": (1.0, 2.0), "particles": 8.0}),
        (SteinSettings, {"inference": "tempered", "step_size": None}),
    ],
)
def test_numbers_names_and_switches_are_taken(model, given):
    settings = model(**given)
    for name, value in given.items():
        found = getattr(settings, name)
        assert np.all(np.asarray(found) == np.asarray(value))
    assert model.model_validate_json(settings.model_dump_json()) == settings
