"""Limits of the number of physics worlds in a process, beyond which PyBullet dies."""

from __future__ import annotations

import resource
from pathlib import Path

__all__ = ["MOST_WORLDS", "NEEDED", "Places", "free_memory"]

MOST_WORLDS = 1024
"""Clients of PyBullet in one process (`MAX_PHYSICS_CLIENTS` of its `pybullet.c`)."""

NEEDED = 100 * 2**20
"""Bytes: 28 MB of a world, as measured, its bodies, and what is computed in it."""

_CGROUP = Path("/sys/fs/cgroup")


class Places:
    """The places that the worlds of this process have, each known by a number."""

    def __init__(self) -> None:
        self._taken: set[int] = set()
        self._most = 0

    def __len__(self) -> int:
        """Return how many are taken."""
        return len(self._taken)

    def take(self, number: int) -> None:
        """Take a place, once `check` has found one."""
        self._taken.add(number)
        self._most = max(self._most, len(self._taken))

    def give_back(self, number: int) -> None:
        """Let others have a place."""
        self._taken.discard(number)

    def check(self) -> None:
        """Raise an error unless there is room for another world.

        Raises:
            RuntimeError: as many are open as PyBullet allows.
            MemoryError: the memory that is left is too little.
        """
        # The memory of a world that was closed stays with the process, and the next one takes it.
        _check(len(self._taken), anew=len(self._taken) == self._most)


def _check(worlds: int, anew: bool) -> None:
    advice = "close environments that are done with (env.close()), or use fewer at once"
    if worlds >= MOST_WORLDS:
        raise RuntimeError(
            f"PyBullet allows {MOST_WORLDS} physics worlds in a process, and {worlds} are "
            f"open: {advice}, or use several processes"
        )
    if anew and (left := free_memory()) < NEEDED:
        raise MemoryError(
            f"another physics world needs {NEEDED // 2**20} MB of memory, and {left // 2**20} MB "
            f"are left with {worlds} open in this process: {advice}"
        )


def free_memory() -> int:
    """Return the bytes that this process can still take; very many where the system does not say.

    The least of what is left on the machine, in a container, and of the limit of address space.
    """
    left = [2**62]
    for line in _lines(Path("/proc/meminfo")):
        if line.startswith("MemAvailable:"):
            left.append(int(line.split()[1]) * 1024)
    most, used = _number(_CGROUP / "memory.max"), _number(_CGROUP / "memory.current")
    if most is not None and used is not None:
        # Copies of files in memory are given up first.
        cached = [line for line in _lines(_CGROUP / "memory.stat") if line.startswith("file ")]
        left.append(most - used + sum(int(line.split()[1]) for line in cached))
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    size = [int(line.split()[0]) for line in _lines(Path("/proc/self/statm"))]
    if limit != resource.RLIM_INFINITY and size:
        left.append(limit - size[0] * resource.getpagesize())
    return max(0, min(left))


def _lines(path: Path) -> list[str]:
    try:
        return path.read_text().splitlines()
    except OSError:
        return []


def _number(path: Path) -> int | None:
    text = " ".join(_lines(path)).strip()
    return int(text) if text.isdecimal() else None
