"""Playing many episodes in worker processes, each row stored as soon as its episode ends."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any, Generic, TypeVar

from smp_planner.benchmark.episodes import EpisodeKey, EpisodePlayer, EpisodeRow
from smp_planner.benchmark.manifest import EpisodeStore, Manifest
from smp_planner.benchmark.results_folder import ResultsFolder
from smp_planner.benchmark.worker_pool import GRACE, Backend, workers

__all__ = [
    "EpisodeFailedError",
    "WorkerDiedError",
    "draw",
    "play_all",
    "play_missing",
    "run",
]

Key = TypeVar("Key")
Row = TypeVar("Row")


class WorkerDiedError(RuntimeError):
    """A worker process ended without a result (killed, or out of memory)."""


class EpisodeFailedError(RuntimeError):
    """Playing an episode raised an exception; the message names the episode."""


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
    keys: Sequence[Key],
    player: Callable[[Key], Row],
    jobs: int,
    done: Callable[[Row], None],
    backend: Backend = "processes",
) -> None:
    """Play episodes in `jobs` workers and hand over each row as it comes.

    Args:
        keys: what is played, in order.
        player: returns the row of a key; importable by name, for it runs in other processes.
        jobs: number of worker processes.
        done: called with each row in this process.
        backend: of `smp_planner.benchmark.worker_pool.workers`.

    Raises:
        BrokenProcessPool: a worker process was killed.
        EpisodeFailedError: the player raised an exception.
    """
    waiting = iter(keys)
    running: set[Future[Row]] = set()
    with workers(jobs, backend) as pool:
        try:
            while True:
                while len(running) < 2 * jobs and (key := next(waiting, None)) is not None:
                    running.add(pool.submit(_Play(player), key))
                if not running:
                    return
                finished, running = wait(running, return_when=FIRST_COMPLETED)
                _take(finished, done)
        except BaseException as error:
            # What is being played is worth keeping; whoever interrupts does not wait for long.
            for future in running:
                future.cancel()
            finished, _ = wait(running, None if isinstance(error, Exception) else GRACE)
            if not isinstance(error, BrokenProcessPool):
                _take({f for f in finished if not f.cancelled() and not f.exception()}, done)
            raise


def play_missing(
    store: ResultsFolder[Any, Any],
    keys: Sequence[Key],
    player: Callable[[Key], Any],
    *,
    jobs: int = 1,
    backend: Backend = "processes",
    on_progress: Callable[[int, int], None] = lambda done, total: None,
) -> None:
    """Play what a folder does not hold yet, and store each row as it comes.

    An exception, `KeyboardInterrupt` included, leaves a folder that the same call continues.

    Args:
        store: the folder.
        keys: of its rows, in the order of play.
        player: returns the row of a key; importable by name, for it runs in other processes.
        jobs: number of worker processes.
        backend: of `smp_planner.benchmark.worker_pool.workers`.
        on_progress: called with the number of keys that are done and of all.

    Raises:
        WorkerDiedError: a worker process was killed.
        EpisodeFailedError: the player raised an exception.
        ValueError: `jobs` is below 1.
    """
    _check_jobs(jobs)
    missing = store.missing(keys)
    done = len(keys) - len(missing)
    on_progress(done, len(keys))

    def keep(row: Any) -> None:
        nonlocal done
        store.append(row)
        done += 1
        on_progress(done, len(keys))

    try:
        if missing:
            play_all(missing, player, min(jobs, len(missing)), keep, backend)
    except BrokenProcessPool as error:
        raise WorkerDiedError(
            f"a worker process died (killed, or out of memory) after {done} of {len(keys)}, which "
            f"are kept in {str(store.folder)!r}: the same command continues there, with fewer "
            "--jobs if memory is short"
        ) from error


def _check_jobs(jobs: int) -> None:
    """Raise ValueError unless there is a worker at least."""
    if jobs < 1:
        raise ValueError(f"jobs must be at least 1, got {jobs}")


def run(
    manifest: Manifest,
    folder: Path,
    *,
    jobs: int = 1,
    backend: Backend = "processes",
    restart: bool = False,
    player: EpisodePlayer | None = None,
    on_progress: Callable[[int, int], None] = lambda done, total: None,
) -> list[EpisodeRow]:
    """Play all episodes that `folder` does not hold yet, and return all rows, sorted.

    Rows do not depend on `jobs` and `backend`, times excepted; see `play_missing`.

    Args:
        manifest: what to play, from `make_manifest`.
        folder: of the results.
        jobs: number of worker processes.
        backend: of `smp_planner.benchmark.worker_pool.workers`.
        restart: drop the rows of a folder that was made for something else, instead of refusing.
        player: what plays an episode, in place of the manifest's methods.
        on_progress: called with the number of episodes that are done and of all.

    Raises:
        ResultsError: the folder is of other settings or damaged.
        OSError: it is in use, or cannot be written to.
        WorkerDiedError: a worker process was killed.
        EpisodeFailedError: an episode raised an exception.
        ValueError: `jobs` is below 1.
    """
    _check_jobs(jobs)
    with EpisodeStore(folder, manifest, restart=restart) as store:
        play_missing(
            store,
            manifest.episode_keys(),
            player or manifest.player,
            jobs=jobs,
            backend=backend,
            on_progress=on_progress,
        )
        return sorted(store.rows, key=lambda row: row.key)


def draw(
    manifest: Manifest,
    folder: Path,
    keys: Sequence[EpisodeKey] = (),
    *,
    jobs: int = 1,
    figure: bool = True,
    video: bool = True,
) -> list[Path]:
    """Play episodes again, and write their figures and videos.

    Args:
        manifest: of the run.
        folder: of the files; made if there is none.
        keys: of the episodes; none for the first of each cell and method.
        jobs: number of worker processes.
        figure: whether to write figures.
        video: whether to write videos.

    Returns:
        The files that were written.
    """
    from smp_planner.benchmark.episode_pictures import draw_episode

    folder.mkdir(parents=True, exist_ok=True)
    keys = keys or manifest.first_keys()
    if not (figure or video):
        return []
    player = manifest.player
    with workers(min(jobs, len(keys))) as pool:
        futures = [pool.submit(draw_episode, player, key, folder, figure, video) for key in keys]
        return [path for future in futures for path in future.result()]
