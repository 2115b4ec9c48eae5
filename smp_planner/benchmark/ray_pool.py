"""Workers of a Ray cluster, on one machine or many, behind the interface of a pool of processes.

``RAY_ADDRESS`` names the cluster, as Ray has it (``auto`` is the one that ``ray start`` has begun
on this machine); without it, one is begun here for as long as the pool is open. What a worker that
was killed or a node that was lost had in hand is done by another.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from functools import lru_cache
from typing import Any

from smp_gym.optional_packages import require
from smp_planner.benchmark.manifest import code_digest, versions
from smp_planner.benchmark.results_folder import ResultsError

__all__ = ["cluster_cores", "ray_workers"]

# The least that Ray takes: rows are small.
_OBJECT_STORE = 80 * 2**20

_Code = tuple[str, dict[str, str]]


def _ray() -> Any:
    # It reports to its makers otherwise.
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    require("ray", "the backend 'ray'")
    import ray

    return ray


@contextmanager
def _connected(cores: int | None, variables: dict[str, str]) -> Iterator[Any]:
    """Connect to the cluster, or begin one of so many cores."""
    ray = _ray()
    address = os.environ.get("RAY_ADDRESS", "local")
    begun = {"num_cpus": cores, "object_store_memory": _OBJECT_STORE, "include_dashboard": False}
    try:
        ray.init(
            address,
            runtime_env={"env_vars": {**variables, "PYTHONPATH": _own_paths()}},
            logging_level="ERROR",
            log_to_driver=False,
            **(begun if address == "local" else {}),
        )
    except (ConnectionError, ValueError) as error:
        raise ConnectionError(f"no Ray cluster at RAY_ADDRESS={address}: {error}") from error
    try:
        yield ray
    finally:
        ray.shutdown()


def _own_paths() -> str:
    """Return where modules are found here that no installation brings, as for a method's file."""
    installed = (sys.prefix, sys.base_prefix)
    paths = [os.path.abspath(path) for path in sys.path if not path.startswith(installed)]
    return os.pathsep.join(paths)


def cluster_cores() -> int | None:
    """Return the number of cores of the cluster that ``RAY_ADDRESS`` names; None without one.

    Raises:
        ModuleNotFoundError: Ray is not installed; the message says how.
        ConnectionError: the cluster cannot be reached.
    """
    _ray()
    if "RAY_ADDRESS" not in os.environ:
        return None
    with _connected(None, {}) as ray:
        return max(1, int(ray.cluster_resources().get("CPU", 1)))


@lru_cache(maxsize=1)
def _code_here() -> _Code:
    return code_digest(), versions()


def _checked_call(
    code: _Code, function: Callable[..., Any], args: tuple[Any, ...], kwargs: dict[str, Any]
) -> Any:
    """Call a function on a node, which must have the code and the packages of the run."""
    (here, packages), (there, others) = code, _code_here()
    if (here, packages) != (there, others):
        found = {name: version for name, version in others.items() if packages[name] != version}
        raise ResultsError(
            f"the node {os.uname().nodename!r} has other code or packages than this run: code "
            f"{there}, not {here}; {found}"
        )
    return function(*args, **kwargs)


class _RayPool(ThreadPoolExecutor):
    """A pool each of whose threads waits for one task of the cluster at a time."""

    def __init__(self, ray: Any, jobs: int) -> None:
        super().__init__(jobs)
        self._ray = ray
        self._call = ray.remote(_checked_call)
        self._under_way: set[Any] = set()

    def submit(self, function: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Have a function called by a worker of the cluster."""
        return super().submit(self._wait, function, args, kwargs)

    def _wait(
        self, function: Callable[..., Any], args: tuple[Any, ...], kwargs: dict[str, Any]
    ) -> Any:
        errors = self._ray.exceptions
        task = self._call.remote(_code_here(), function, args, kwargs)
        self._under_way.add(task)
        try:
            return self._ray.get(task)
        except errors.RayTaskError as error:
            # As the function raised it; Ray's own has the text of a whole traceback.
            raise error.cause from None
        except errors.RayError as error:
            raise BrokenProcessPool(str(error).splitlines()[0]) from error
        finally:
            self._under_way.discard(task)

    def kill(self) -> None:
        """Kill the workers of what is under way."""
        for task in list(self._under_way):
            self._ray.cancel(task, force=True)


@contextmanager
def ray_workers(jobs: int, variables: dict[str, str]) -> Iterator[ThreadPoolExecutor]:
    """Open a pool of workers of a cluster.

    After an error, what has not begun is dropped; after an interruption, the workers are killed.

    Args:
        jobs: tasks at a time, of a core each.
        variables: of the environment of the workers.

    Raises:
        ModuleNotFoundError: Ray is not installed; the message says how.
        ConnectionError: the cluster cannot be reached.
    """
    with _connected(jobs, variables) as ray:
        pool = _RayPool(ray, jobs)
        try:
            yield pool
        except BaseException as error:
            if not isinstance(error, Exception):
                pool.kill()
            raise
        finally:
            pool.shutdown(cancel_futures=True)
