"""Playing all repetitions of Table II in worker processes, each row stored as it comes."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Sequence
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any

from smp_planner.benchmark.row_file import ResultsError, RowFile, read_rows
from smp_planner.benchmark.runner import WorkerDiedError, play_all
from smp_planner.benchmark.store import code_digest, versions, write_json
from smp_planner.experiments.table_two.repetitions import (
    RepetitionKey,
    RepetitionRow,
    methods_of,
    parse_row,
    play_repetition,
)
from smp_planner.experiments.table_two.scenes import load_scenes

__all__ = ["keys_of", "read", "run"]

_ROWS, _MANIFEST = "repetitions.jsonl", "manifest.json"


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


def _manifest() -> dict[str, Any]:
    scenes = "".join(scene.to_json() for scene in load_scenes().values())
    return {
        "format": 1,
        "code": code_digest(),
        "scenes": hashlib.sha256(scenes.encode()).hexdigest()[:16],
        "versions": versions(),
    }


def _parse(line: str) -> RepetitionRow:
    return parse_row(json.loads(line))


def _adopt(folder: Path, file: RowFile[RepetitionRow]) -> None:
    """Write the manifest, or check that the folder was made with the same code and packages."""
    path, here = folder / _MANIFEST, _manifest()
    if not path.exists():
        if not file.empty:
            raise ResultsError(f"{str(folder)!r} holds rows but no {_MANIFEST}: damaged")
        write_json(path, here)
        return
    there = json.loads(path.read_text(encoding="utf-8"))
    differing = sorted(name for name in {*here, *there} if here.get(name) != there.get(name))
    if differing:
        raise ResultsError(
            f"{str(folder)!r} holds repetitions of another state of {', '.join(differing)} and is "
            "left as it is; choose another folder"
        )


def read(folder: Path) -> list[RepetitionRow]:
    """Return the rows of a folder, sorted.

    Raises:
        ResultsError: a row is damaged.
    """
    return sorted(read_rows(folder / _ROWS, _parse)[0], key=lambda row: row.key)


def run(
    keys: Sequence[RepetitionKey],
    folder: Path,
    *,
    jobs: int = 1,
    player: Callable[[RepetitionKey], RepetitionRow] = play_repetition,
    on_progress: Callable[[int, int], None] = lambda done, total: None,
) -> None:
    """Play the repetitions that a folder does not hold yet.

    The same folder may hold other tasks, methods and more repetitions than asked for. An exception,
    `KeyboardInterrupt` included, leaves a folder that the same call continues.

    Args:
        keys: from `keys_of`.
        folder: of the results; made if there is none.
        jobs: number of worker processes.
        player: what plays a repetition; importable by name, for it runs in other processes.
        on_progress: called with the number of repetitions that are done and of all.

    Raises:
        ResultsError: the folder was made with other code, packages or scenes, is damaged or in use.
        WorkerDiedError: a worker process was killed.
        EpisodeFailedError: a repetition raised an exception.
        ValueError: `jobs` is below 1.
    """
    if jobs < 1:
        raise ValueError(f"jobs must be at least 1, got {jobs}")
    folder.mkdir(parents=True, exist_ok=True)
    file = RowFile(folder / _ROWS, _parse)
    try:
        _adopt(folder, file)
        present = {row.key for row in file.read()}
        missing = [key for key in keys if key not in present]
        done = len(keys) - len(missing)
        on_progress(done, len(keys))

        def keep(row: RepetitionRow) -> None:
            nonlocal done
            file.append(row.content())
            done += 1
            on_progress(done, len(keys))

        if missing:
            play_all(missing, player, min(jobs, len(missing)), keep)
    except BrokenProcessPool as error:
        raise WorkerDiedError(
            f"a worker process died (killed, or out of memory); what was played is kept in "
            f"{str(folder)!r}: the same command continues there"
        ) from error
    finally:
        file.close()
