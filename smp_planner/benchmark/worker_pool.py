"""Workers that share the cores: each computes on one thread, and ends with what began it."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager
from typing import Literal, get_args

from smp_gym.processes import end_with_parent

__all__ = ["BACKENDS", "GRACE", "START", "Backend", "available_cores", "workers"]

Backend = Literal["processes", "ray"]

BACKENDS: tuple[Backend, ...] = get_args(Backend)
"""Kinds of workers."""

GRACE = 2.0
"""Seconds that work in hand has to end after an interruption, so that it need not be repeated."""

START = "spawn"
"""How processes are started: they import all anew, and share no thread and no lock with this."""

_THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def available_cores(backend: Backend = "processes") -> int:
    """Return the number of cores that this process may use, or of the cluster."""
    if backend == "ray":
        from smp_planner.benchmark.ray_pool import cluster_cores

        if (cores := cluster_cores()) is not None:
            return cores
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _prepare_worker() -> None:
    """End with the parent, and leave it the terminal's signals."""
    end_with_parent()
    for name in ("SIGINT", "SIGHUP"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)


@contextmanager
def workers(jobs: int, backend: Backend = "processes") -> Iterator[Executor]:
    """Open a pool of workers whose numerical libraries use one thread each.

    After an error, what has not begun is dropped; after an interruption, the workers are killed.

    Args:
        jobs: number of workers.
        backend: "processes" are spawned on this machine; "ray" are those of a cluster, see
            `smp_planner.benchmark.ray_pool`.
    """
    variables = dict.fromkeys(_THREAD_VARIABLES, "1")
    if backend == "ray":
        from smp_planner.benchmark.ray_pool import ray_workers

        with ray_workers(jobs, variables) as cluster:
            yield cluster
        return
    before = {name: os.environ.get(name) for name in variables}
    os.environ.update(variables)
    context = multiprocessing.get_context(START)
    pool = ProcessPoolExecutor(jobs, mp_context=context, initializer=_prepare_worker)
    try:
        yield pool
    except BaseException as error:
        if not isinstance(error, Exception):
            # The pool alone knows its processes, and cannot be asked to kill them.
            for process in list((pool._processes or {}).values()):
                process.kill()
        raise
    finally:
        pool.shutdown(cancel_futures=True)
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
