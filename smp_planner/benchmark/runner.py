"""Playing many episodes in worker processes, each row stored as soon as its episode ends."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from pathlib import Path
from typing import Generic, TypeVar

from smp_gym.datasets.frozen import load_episodes
from smp_gym.scene import DIFFICULTIES, FAMILIES, FURNISHED_TASKS, TASKS
from smp_planner.benchmark.episodes import EpisodeKey, EpisodePlayer, EpisodeRow, play
from smp_planner.benchmark.store import EpisodeStore, Manifest, code_digest, versions
from smp_planner.planners import PLANNERS

__all__ = [
    "EpisodeFailedError",
    "WorkerDiedError",
    "available_cores",
    "draw",
    "make_manifest",
    "play_all",
    "run",
]

Key = TypeVar("Key")
Row = TypeVar("Row")

_THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


class WorkerDiedError(RuntimeError):
    """A worker process ended without an answer (killed, or out of memory)."""


class EpisodeFailedError(RuntimeError):
    """Playing an episode raised an exception; the message names the episode."""


def available_cores() -> int:
    """Return how many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def make_manifest(
    tasks: Sequence[str],
    methods: Sequence[str],
    difficulty: str,
    seed: int,
    episodes: int,
    *,
    frozen: bool = False,
    family: str = FAMILIES[0],
) -> Manifest:
    """Return the manifest of a run with the versions that are installed.

    With `frozen` the episodes are the first ones of the frozen lists, and `seed` must be 0. A
    `family` of furniture needs tasks that have it, and is in no frozen list.

    Raises:
        ValueError: a name that does not exist or is given twice, or a number out of range; the
            message names the value and what exists.
    """
    for kind, names, known in (("task", tasks, TASKS), ("method", methods, tuple(PLANNERS))):
        unknown = [name for name in names if name not in known]
        if unknown:
            raise ValueError(f"unknown {kind} {unknown[0]!r}; there are: {', '.join(known)}")
        if not names or len(set(names)) < len(names):
            raise ValueError(f"name each {kind} once and at least one, got {', '.join(names)!r}")
    if difficulty not in DIFFICULTIES:
        raise ValueError(f"unknown difficulty {difficulty!r}; there are: {', '.join(DIFFICULTIES)}")
    if family not in FAMILIES:
        raise ValueError(f"unknown family {family!r}; there are: {', '.join(FAMILIES)}")
    if family != FAMILIES[0]:
        bare = [task for task in tasks if task not in FURNISHED_TASKS]
        if bare or frozen:
            raise ValueError(
                f"family {family!r} needs tasks out of {', '.join(FURNISHED_TASKS)} and is not "
                f"frozen, got {bare[0] if bare else 'frozen'}"
            )
    if episodes < 1:
        raise ValueError(f"episodes must be at least 1, got {episodes}")
    if seed < 0:
        raise ValueError(f"seed must not be negative, got {seed}")
    if frozen:
        if seed:
            raise ValueError(f"frozen lists have seeds of their own: seed must be 0, got {seed}")
        least = min(len(load_episodes(task, difficulty)) for task in tasks)
        if episodes > least:
            raise ValueError(f"the frozen lists hold {least} episodes, got episodes {episodes}")
    return Manifest(
        tuple(tasks),
        tuple(methods),
        difficulty,
        seed,
        episodes,
        versions(),
        code_digest(),
        frozen,
        family,
    )


def _prepare_worker() -> None:
    """Leave Ctrl-C to the parent, and compute on one thread: workers share the cores."""
    import torch

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    torch.set_num_threads(1)


@contextmanager
def _workers(jobs: int) -> Iterator[ProcessPoolExecutor]:
    """Open a pool of spawned processes whose numerical libraries use one thread each."""
    before = {name: os.environ.get(name) for name in _THREAD_VARIABLES}
    os.environ.update(dict.fromkeys(_THREAD_VARIABLES, "1"))
    context = multiprocessing.get_context("spawn")
    try:
        with ProcessPoolExecutor(jobs, mp_context=context, initializer=_prepare_worker) as pool:
            yield pool
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


class _Play(Generic[Key, Row]):
    """Calls a player, and lets every exception cross the process border as text."""

    def __init__(self, player: Callable[[Key], Row]) -> None:
        self.player = player

    def __call__(self, key: Key) -> Row:
        try:
            return self.player(key)
        except Exception as error:
            raise EpisodeFailedError(f"{key}: {type(error).__name__}: {error}") from error


def _take(futures: set[Future[Row]], done: Callable[[Row], None]) -> None:
    """Hand over the rows of finished futures, then raise the first error among them."""
    errors = []
    for future in futures:
        if future.cancelled():
            continue
        error = future.exception()
        if error is None:
            done(future.result())
        else:
            errors.append(error)
    if errors:
        raise errors[0]


def play_all(
    keys: Sequence[Key], player: Callable[[Key], Row], jobs: int, done: Callable[[Row], None]
) -> None:
    """Play episodes in `jobs` spawned processes and hand over each row as it comes.

    Args:
        keys: what is played, in order.
        player: returns the row of a key; importable by name, for it runs in other processes.
        jobs: number of worker processes.
        done: called with each row in this process.

    Raises:
        BrokenProcessPool: a worker process was killed.
        EpisodeFailedError: the player raised an exception.
    """
    waiting = iter(keys)
    running: set[Future[Row]] = set()
    with _workers(jobs) as pool:
        try:
            while True:
                while len(running) < 2 * jobs and (key := next(waiting, None)) is not None:
                    running.add(pool.submit(_Play(player), key))
                if not running:
                    return
                finished, running = wait(running, return_when=FIRST_COMPLETED)
                _take(finished, done)
        except BaseException as error:
            # What is being played is worth keeping: it is over in seconds.
            for future in running:
                future.cancel()
            finished, _ = wait(running)
            if not isinstance(error, BrokenProcessPool):
                _take({f for f in finished if not f.cancelled() and not f.exception()}, done)
            raise


def run(
    manifest: Manifest,
    folder: Path,
    *,
    jobs: int = 1,
    restart: bool = False,
    player: EpisodePlayer = play,
    on_progress: Callable[[int, int], None] = lambda done, total: None,
) -> list[EpisodeRow]:
    """Play all episodes that `folder` does not hold yet, and return all rows, sorted.

    Rows do not depend on `jobs`, times excepted. An exception, `KeyboardInterrupt` included, leaves
    a folder that the same call continues.

    Args:
        manifest: what to play, from `make_manifest`.
        folder: of the results.
        jobs: number of worker processes.
        restart: drop the rows of a folder that was made for something else, instead of refusing.
        player: what plays an episode; importable by name, for it runs in other processes.
        on_progress: called with the number of episodes that are done and of all.

    Raises:
        ResultsError: the folder is of other settings, damaged or in use.
        WorkerDiedError: a worker process was killed.
        EpisodeFailedError: an episode raised an exception.
        ValueError: `jobs` is below 1.
    """
    if jobs < 1:
        raise ValueError(f"jobs must be at least 1, got {jobs}")
    keys = manifest.episode_keys()
    with EpisodeStore(folder, manifest, restart=restart) as store:
        missing = store.missing(keys)
        on_progress(len(keys) - len(missing), len(keys))

        def keep(row: EpisodeRow) -> None:
            store.append(row)
            on_progress(len(keys) - len(store.missing(keys)), len(keys))

        try:
            if missing:
                play_all(missing, player, min(jobs, len(missing)), keep)
        except BrokenProcessPool as error:
            raise WorkerDiedError(
                f"a worker process died (killed, or out of memory) after "
                f"{len(keys) - len(store.missing(keys))} of {len(keys)} episodes, which are kept "
                f"in {str(folder)!r}: the same command continues there, with fewer --jobs if "
                "memory is short"
            ) from error
        return sorted(store.rows, key=lambda row: row.key)


def draw(
    keys: Sequence[EpisodeKey],
    folder: Path,
    *,
    jobs: int = 1,
    figure: bool = True,
    video: bool = True,
) -> list[Path]:
    """Play episodes again, as the workers of `run` do, and write their figures and videos.

    Args:
        keys: names of the episodes.
        folder: of the files; made if there is none.
        jobs: number of worker processes.
        figure: whether to write figures.
        video: whether to write videos.

    Returns:
        The files that were written.
    """
    from smp_planner.benchmark.figures import draw_episode

    folder.mkdir(parents=True, exist_ok=True)
    if not keys or not (figure or video):
        return []
    with _workers(min(jobs, len(keys))) as pool:
        futures = [pool.submit(draw_episode, key, folder, figure, video) for key in keys]
        return [path for future in futures for path in future.result()]
