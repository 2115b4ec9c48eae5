"""Playing all repetitions of Table II in worker processes, each row stored as it comes."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from smp_gym.scene import TASKS
from smp_planner.benchmark.manifest import code_digest, versions
from smp_planner.benchmark.results_folder import ResultsFolder, ResultsKind, read_folder
from smp_planner.benchmark.row_table import RowTable, checked
from smp_planner.benchmark.runner import play_missing
from smp_planner.experiments.table_two.repetitions import (
    METHODS,
    RepetitionKey,
    RepetitionRow,
    methods_of,
    play_repetition,
)
from smp_planner.experiments.table_two.scenes import load_scenes

__all__ = ["keys_of", "read", "run"]


def keys_of(tasks: Sequence[str], methods: Sequence[str], repetitions: int) -> list[RepetitionKey]:
    """Return all repetitions, in the order in which they are played.

    The first of every task and method comes before the second of any, so that a run that is cut
    short holds so many repetitions of all.
    """
    return [
        RepetitionKey(repetition, task, method)
        for repetition in range(repetitions)
        for task in tasks
        for method in methods_of(task, methods)
    ]


@dataclass(frozen=True)
class _Manifest:
    code: str
    scenes: str
    versions: dict[str, str]


def _manifest() -> _Manifest:
    scenes = "".join(scene.to_json() for scene in load_scenes().values())
    return _Manifest(code_digest(), hashlib.sha256(scenes.encode()).hexdigest()[:16], versions())


def _belongs(key: RepetitionKey) -> bool:
    """Return whether a repetition can be one of a run."""
    return key.task in TASKS and key.method in METHODS and key.repetition >= 0


_REPETITIONS: ResultsKind[_Manifest, RepetitionRow] = ResultsKind(
    RowTable("repetitions", RepetitionRow, RepetitionKey),
    lambda content: checked(_Manifest, json.dumps(content)),
    lambda manifest: _belongs,
)


def read(folder: Path) -> list[RepetitionRow]:
    """Return the rows of a folder, sorted.

    Raises:
        ResultsError: there are no results, or they are damaged or of something else.
    """
    _, rows = read_folder(folder, _REPETITIONS)
    return sorted(rows, key=lambda row: row.key)


def run(
    keys: Sequence[RepetitionKey],
    folder: Path,
    *,
    jobs: int = 1,
    player: Callable[[RepetitionKey], RepetitionRow] = play_repetition,
    on_progress: Callable[[int, int], None] = lambda done, total: None,
) -> None:
    """Play the repetitions that a folder does not hold yet; see `play_missing`.

    The same folder may hold other tasks, methods and more repetitions than asked for.

    Args:
        keys: from `keys_of`.
        folder: of the results; made if there is none.
        jobs: number of worker processes.
        player: what plays a repetition; importable by name, for it runs in other processes.
        on_progress: called with the number of repetitions that are done and of all.

    Raises:
        ResultsError: the folder was made with other code, packages or scenes, or is damaged.
        OSError: it is in use, or cannot be written to.
        WorkerDiedError: a worker process was killed.
        EpisodeFailedError: a repetition raised an exception.
        ValueError: `jobs` is below 1.
    """
    with ResultsFolder(folder, _REPETITIONS, asdict(_manifest())) as store:
        play_missing(store, keys, player, jobs=jobs, on_progress=on_progress)
