"""Rounds of the double oracle that finds the blind detours which the samplers keep blocked."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from smp_gym.arrays import FloatArray
from smp_gym.atomic_files import write_text
from smp_gym.sampling import sample_scene
from smp_gym.sampling.blind_detours import BLIND_DETOURS, FUNCTIONS, load_blind_detours
from smp_planner.agents.posed_scenes import posed
from smp_planner.experiments.controls.detour import Detour, SearchSettings, learn_detour

__all__ = ["BLOCKED_TASKS", "add_blind_detour", "store_blind_detour"]

BLOCKED_TASKS = ("Placement", "DoubleSidedPlacement")
"""Tasks whose samplers keep blind detours blocked."""


def add_blind_detour(
    task: str, difficulty: str, seeds: Sequence[int], settings: SearchSettings
) -> Detour:
    """Learn the best fixed detour for the present scenes, and have the sampler block it from now.

    Args:
        task: one of `BLOCKED_TASKS`.
        difficulty: of the scenes.
        seeds: of the scenes; the last of them validate.
        settings: of the search.
    """
    problems = posed([sample_scene(task, difficulty, seed) for seed in seeds])
    found = learn_detour(task, problems, settings, seed=seeds[0])
    store_blind_detour(task, found.component, found.numbers)
    return found


def store_blind_detour(
    task: str, side: int, numbers: FloatArray, file: Path = BLIND_DETOURS
) -> None:
    """Add a detour, (18,) rad, functions first, to those of a task and side."""
    known = json.loads(file.read_text())
    known[task][side] += np.round(numbers, 3).reshape(-1, FUNCTIONS, 6).tolist()
    write_text(file, json.dumps(known))
    load_blind_detours.cache_clear()
