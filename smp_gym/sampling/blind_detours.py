"""Blind detours: detours on the mean that are the same in every scene, and got through many.

Where one detour gets through most of a task's scenes, a policy need not look at them. So the best
that a search found in earlier scenes are kept here, and the samplers see to it that obstacles block
them, as they block what a primitive proposes (a double oracle: McMahan, Gordon and Blum 2003,
"Planning in the presence of cost functions controlled by an adversary").
`scripts/learn_blind_detours.py` adds to them, learned on tuning seeds.
"""

from __future__ import annotations

import functools
import json

import numpy as np

from smp_gym.arrays import FloatArray
from smp_gym.assets import asset_path

__all__ = ["BLIND_DETOURS", "FUNCTIONS", "detour_functions", "load_blind_detours"]

FUNCTIONS = 3
"""Smooth functions of the phase that make up a blind detour, for each joint."""

BLIND_DETOURS = asset_path("sampling", "blind_detours.json")
"""By task, for each of its sides, a list of detours: (3, 6) rad, functions first."""


def detour_functions(samples: int) -> FloatArray:
    """Return (3, T): sin(pi s) sin(k pi s), of greatest value 1; value and slope vanish at ends."""
    phase = np.linspace(0.0, 1.0, samples)
    order = np.arange(1, FUNCTIONS + 1)[:, None]
    functions = np.sin(np.pi * phase) * np.sin(np.pi * order * phase)
    return np.asarray(functions / np.abs(functions).max(axis=1, keepdims=True))


@functools.cache
def load_blind_detours(task: str, side: int) -> FloatArray:
    """Return the blind detours (K, 3, 6) rad of a task to one of its sides, functions first."""
    sides = json.loads(BLIND_DETOURS.read_text())[task]
    return np.array(sides[side], np.float64).reshape(-1, FUNCTIONS, 6)
