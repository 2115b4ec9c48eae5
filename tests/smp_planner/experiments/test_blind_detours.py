"""The keeping of blind detours in their file, and what the samplers make of them."""

import json

import numpy as np

from smp_gym.sampling.blind_detours import load_blind_detours
from smp_gym.tasks.placement.scenes import demonstrated_transfer
from smp_planner.experiments.controls.blind_detours import store_blind_detour


def test_a_detour_is_added_to_those_of_its_task_and_side(tmp_path):
    file = tmp_path / "blind_detours.json"
    file.write_text(json.dumps({"Placement": [[]], "DoubleSidedPlacement": [[], []]}))
    numbers = np.linspace(-1.0, 1.0, 18)
    store_blind_detour("DoubleSidedPlacement", 1, numbers, file)
    kept = json.loads(file.read_text())
    assert (kept["Placement"], kept["DoubleSidedPlacement"][0]) == ([[]], [])
    np.testing.assert_allclose(
        np.ravel(kept["DoubleSidedPlacement"][1]), numbers, rtol=0.0, atol=5e-4
    )
    assert [path.name for path in tmp_path.iterdir()] == [file.name]


def test_the_sampler_knows_a_detour_at_once(tmp_path, monkeypatch):
    file = tmp_path / "blind_detours.json"
    file.write_text(json.dumps({"Placement": [[]]}))
    monkeypatch.setattr("smp_gym.sampling.blind_detours.BLIND_DETOURS", file)
    load_blind_detours.cache_clear()
    assert len(demonstrated_transfer().blind) == 0
    store_blind_detour("Placement", 0, np.zeros(18), file)
    assert demonstrated_transfer().blind.shape == (1, 3, 6)
    monkeypatch.undo()
    load_blind_detours.cache_clear()
    assert len(demonstrated_transfer().blind) > 1
