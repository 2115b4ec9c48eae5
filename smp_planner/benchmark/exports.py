"""Exports of a run for other programs: rows as CSV or Parquet, particle sets and paths as .npz."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from smp_gym.atomic_files import replacing
from smp_gym.optional_packages import require
from smp_gym.rollout import FieldRecorder
from smp_planner.benchmark.episodes import (
    TIMES,
    EpisodeKey,
    EpisodeRow,
    PlayMethods,
    environment_id,
    play_episode,
)
from smp_planner.benchmark.results_folder import ResultsError
from smp_planner.benchmark.summary import write_csv
from smp_planner.occupancy.archive import write_archive
from smp_planner.planning.plan import Plan

__all__ = ["export_episode", "write_csv", "write_parquet"]

_OF_PARTICLES = (
    "trajectories",
    "collision_free",
    "clearance",
    "passing",
    "duration",
    "executable",
    "ranks",
    "signatures",
    "good",
    "weights",
    "components",
)
"""Fields of a plan that an export holds under their names, where the method has them."""


def write_parquet(path: Path, rows: Sequence[EpisodeRow]) -> None:
    """Write rows, sorted by their keys, as a Parquet file with a column for each field.

    Raises:
        ModuleNotFoundError: pyarrow is not installed; the message says how.
    """
    require("parquet", "writing Parquet")
    import pyarrow
    from pyarrow import parquet

    kinds = {
        "bool": pyarrow.bool_(),
        "int": pyarrow.int64(),
        "float": pyarrow.float64(),
        "str": pyarrow.string(),
        "Mapping[str, float]": pyarrow.map_(pyarrow.string(), pyarrow.float64()),
    }
    ordered = sorted(rows, key=lambda row: row.key)
    columns = {}
    for each in fields(EpisodeRow):
        values = [getattr(row, each.name) for row in ordered]
        if each.name == "stage_times":
            values = [list(value.items()) for value in values]
        kind = kinds[str(each.type).removesuffix(" | None")]
        columns[each.name] = pyarrow.array(values, kind)
    with replacing(path) as aside:
        parquet.write_table(pyarrow.table(columns), aside)


def export_episode(player: PlayMethods, folder: Path, row: EpisodeRow) -> Path:
    """Play an episode again, and write its particle set and the executed path.

    The file ``CELL_METHOD_SEED.npz`` (of a frozen list ``CELL_METHOD_HALF_SEED.npz``) has the
    arrays of `smp_planner.planning.plan.Plan` by their names, each cost as ``cost_NAME``, and
    ``chosen``; of the execution ``configurations`` (steps + 1, 6), rad, ``end_effector_path`` and
    ``object_path`` (steps + 1, 3), m; as JSON the row, ``header``, and the ``scene``.

    Args:
        player: of the run's methods.
        folder: of the file; must exist.
        row: of the episode.

    Returns:
        The file that was written.

    Raises:
        ResultsError: the episode did not go as its row says: code or packages are others now.
    """
    key = row.key
    env = gym.make(environment_id(key.task), **key.cell.make_arguments())
    arm, hand = FieldRecorder("configuration"), FieldRecorder("end_effector_position")
    try:
        played = play_episode(key, env, player.policy(key), (arm, hand), player.lists)
    finally:
        env.close()
    differences = _differences(row, played.row)
    if differences:
        raise ResultsError(
            f"{key} did not go as its row says, so that code or packages are others now: "
            f"{differences}"
        )
    arrays = {
        **_of_plan(played.plan),
        "configurations": arm.values,
        "end_effector_path": hand.values,
        "object_path": played.object_path,
        "scene": played.row.scene,
    }
    path = folder / _name(key)
    header = {name: value for name, value in asdict(played.row).items() if name != "scene"}
    kept = {name: np.asarray(value) for name, value in arrays.items() if value is not None}
    write_archive(path, header, kept)
    return path


def _of_plan(plan: Plan | None) -> dict[str, Any]:
    """Return the arrays of a plan; none of a method that acts without one."""
    if plan is None:
        return {}
    costs = {f"cost_{name}": values for name, values in plan.costs.items()}
    return {name: getattr(plan, name) for name in _OF_PARTICLES} | costs | {"chosen": plan.chosen}


def _name(key: EpisodeKey) -> str:
    parts = (key.cell.name, key.method, key.half, str(key.seed))
    return "_".join(part for part in parts if part) + ".npz"


def _differences(stored: EpisodeRow, played: EpisodeRow) -> Mapping[str, Any]:
    """Return the fields in which two rows of one episode differ, times aside, with both values."""
    return {
        each.name: (getattr(stored, each.name), getattr(played, each.name))
        for each in fields(EpisodeRow)
        if each.name not in (*TIMES, "scene")
        and getattr(stored, each.name) != getattr(played, each.name)
    }
