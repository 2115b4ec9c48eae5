"""Rounds of the double oracle that finds the blind detours which the samplers keep blocked."""

from __future__ import annotations

from collections.abc import Sequence

from smp_gym.sampling import sample_scene
from smp_gym.sampling.blind_detours import store_blind_detour
from smp_gym.tasks.double_sided_placement.scenes import demonstrated_transfers
from smp_gym.tasks.placement.scenes import demonstrated_transfer
from smp_planner.experiments.controls.detour import Detour, SearchSettings, learn_detour
from smp_planner.experiments.controls.posed_scenes import posed

__all__ = ["BLOCKED_TASKS", "add_blind_detour"]

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
    demonstrated_transfer.cache_clear()
    demonstrated_transfers.cache_clear()
    return found
