"""Threads that share the work on a set of particles."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from queue import SimpleQueue
from types import TracebackType

import torch

__all__ = ["MOST_THREADS", "Threads", "default_threads"]

MOST_THREADS = 4
"""Threads of one plan, unless more are asked for: beyond, waking them costs what they save."""


def default_threads() -> int:
    """Return how many threads a plan uses unless it is told: as many as torch uses.

    So `torch.set_num_threads` and ``OMP_NUM_THREADS`` govern both; never more than the cores that
    this process may run on.
    """
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return max(1, min(torch.get_num_threads(), cores or 1, MOST_THREADS))


class Threads:
    """A few threads, the caller's own among them, that compute on rows of arrays.

    What they call must give up the interpreter's lock, or they only take turns. They start when
    first used, and end with the context.

    Args:
        count: threads, at least 1.

    Raises:
        ValueError: `count` is not a positive integer.
    """

    def __init__(self, count: int) -> None:
        if isinstance(count, bool) or not isinstance(count, int) or count < 1:
            raise ValueError(f"threads must be a positive integer, got {count!r}")
        self.count = count
        self._jobs: SimpleQueue[tuple[Callable[[slice], None], slice] | None] = SimpleQueue()
        self._done: SimpleQueue[BaseException | None] = SimpleQueue()
        self._workers: list[threading.Thread] = []

    def __enter__(self) -> Threads:
        """Return itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """End the threads."""
        for _ in self._workers:
            self._jobs.put(None)
        for worker in self._workers:
            worker.join()
        self._workers.clear()

    def over(self, rows: int, work: Callable[[slice], None]) -> None:
        """Call `work` for slices that make up the rows 0 .. `rows` - 1, and wait for all of them.

        Raises:
            Exception: whatever `work` raised first.
        """
        count = min(self.count, rows)
        if count < 2:
            work(slice(0, rows))
            return
        while len(self._workers) < count - 1:
            worker = threading.Thread(target=self._serve, daemon=True)
            worker.start()
            self._workers.append(worker)
        edges = [rows * k // count for k in range(count + 1)]
        for k in range(1, count):
            self._jobs.put((work, slice(edges[k], edges[k + 1])))
        failed: BaseException | None = None
        try:
            work(slice(0, edges[1]))
        except BaseException as error:
            failed = error
        for _ in range(1, count):
            failed = self._done.get() or failed
        if failed is not None:
            raise failed

    def _serve(self) -> None:
        while (job := self._jobs.get()) is not None:
            try:
                job[0](job[1])
            except BaseException as error:
                self._done.put(error)
            else:
                self._done.put(None)
