"""Blind detours: detours on the mean that are the same in every scene, and got through many.

Where one detour gets through most of a task's scenes, a policy need not look at them. So the best
that a search found in earlier scenes are kept here, and the samplers see to it that obstacles block
them, as they block what a primitive proposes (a double oracle: McMahan, Gordon and Blum 2003,
"Planning in the presence of cost functions controlled by an adversary").
`scripts/learn_blind_detours.py` adds to them.
"""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np

from smp_gym.arrays import FloatArray
from smp_gym.assets import asset_path

__all__ = ["FUNCTIONS", "detour_functions", "load_blind_detours", "store_blind_detour"]

FUNCTIONS = 3
"""Smooth functions of the phase that make up a blind detour, for each joint."""

_FILE = asset_path("sampling", "blind_detours.json")
_SHAPE = (-1, FUNCTIONS, 6)


def detour_functions(samples: int) -> FloatArray:
    """Return (3, T): sin(pi s) sin(k pi s), of greatest value 1; value and slope vanish at ends."""
    phase = np.linspace(0.0, 1.0, samples)
    order = np.arange(1, FUNCTIONS + 1)[:, None]
    functions = np.sin(np.pi * phase) * np.sin(np.pi * order * phase)
    return np.asarray(functions / np.abs(functions).max(axis=1, keepdims=True))


def load_blind_detours(task: str, side: int) -> FloatArray:
    """Return the blind detours (K, 3, 6) rad of a task to one of its sides, functions first."""
    sides = json.loads(_FILE.read_text())[task]
    return np.array(sides[side], np.float64).reshape(_SHAPE)


def store_blind_detour(task: str, side: int, numbers: FloatArray, file: Path = _FILE) -> None:
    """Add a detour, (18,) rad, functions first, to those of a task and side."""
    known = json.loads(file.read_text())
    known[task][side] += np.round(numbers, 3).reshape(_SHAPE).tolist()
    complete = file.with_suffix(".new")
    complete.write_text(json.dumps(known))
    os.replace(complete, file)
