"""Kills of work at random moments: whole is what it keeps, and its end as if undisturbed."""

from __future__ import annotations

import os
import signal
import time
import traceback
from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from smp_gym.atomic_files import write_text

__all__ = ["FAULTS", "KILLS", "Work", "killed_at_random"]

KILLS = "kills"

FAULTS = ("failed", "torn", "lost", "other", "left over")
"""Going on raised an error; a file was there that is not whole; what had been kept was gone or
changed; the end was another than that of undisturbed work; a process outlived the killed one."""

_PATIENCE = 5.0
"""Seconds until a process counts as left over."""

_ROUNDS = 8
"""Kills in one folder, after which the work may come to its end."""

_FAILED = 1
"""Exit status of work that raised an error."""


@dataclass(frozen=True)
class Work:
    """Work in a folder that goes on after a kill.

    Attributes:
        kind: its name.
        go_on: begins in a folder that need not exist, or goes on there, to the end.
        kept: what a folder holds for good at a moment, by name; raises an error where a file is
            not whole. Nothing before the first is kept.
        result: what it holds at the end, beside what is kept.
    """

    kind: str
    go_on: Callable[[Path], None]
    kept: Callable[[Path], Mapping[Any, Any]]
    result: Callable[[Path], Any] = lambda folder: None


def killed_at_random(
    work: Work,
    folder: Path,
    kills: int,
    rng: np.random.Generator,
    report: Callable[[str], None] = lambda line: None,
) -> Counter[str]:
    """Return how many kills and faults of each kind there were.

    The work is done in processes that are forked from this one, which has its modules and kernels
    already. Killed (SIGKILL) is the first of them or one that it began, each as often, at a moment
    that is uniform over what is left to do.

    Args:
        work: to be killed.
        folder: to work below.
        kills: how many.
        rng: of the moments and of what is killed.
        report: is told of each fault.

    Raises:
        RuntimeError: undisturbed work fails.
    """
    whole, tally = folder / "whole", Counter({KILLS: 0})

    def count(fault: str, told: str) -> None:
        tally[fault] += 1
        report(f"{fault}: {work.kind}, after {tally[KILLS]} kills: {told[:300]}")

    began = time.monotonic()
    if _ended(_started(work, whole)) != 0:
        raise RuntimeError(f"{work.kind} fails without a kill: {_told(whole)}")
    longest = time.monotonic() - began
    wanted, result = dict(work.kept(whole)), work.result(whole)
    number = rounds = 0
    kept: dict[Any, Any] = {}
    while tally[KILLS] < kills:
        out = folder / str(number)
        rest = longest * (1.0 - len(kept) / len(wanted)) or longest
        run = _started(work, out)
        moment = float(rng.uniform(0.0, rest))
        victim, others = _killed_after(run, moment, rng)
        if victim == "failed":
            count("failed", f"before a kill: {_told(out)}")
        elif victim:
            tally[KILLS] += 1
            rounds += 1
        left = psutil.wait_procs(others, _PATIENCE)[1]
        if left:
            count("left over", f"{len(left)} processes, {victim} killed after {moment:.2f} s")
            for process in left:
                process.kill()
        before = kept
        try:
            kept = dict(work.kept(out))
        except Exception as error:
            count("torn", f"{victim} killed after {moment:.2f} s: {error!r}")
        if lost := [name for name in before if before[name] != kept.get(name)]:
            count("lost", f"{lost[0]} of {len(before)}, {victim} killed after {moment:.2f} s")
        if not victim or victim == "failed" or rounds >= _ROUNDS or tally[KILLS] == kills:
            if _ended(_started(work, out)) != 0:
                count("failed", f"going on: {_told(out)}")
            elif difference := _difference(work, out, wanted, result):
                count("other", difference)
            number, rounds, kept = number + 1, 0, {}
    return tally


def _difference(work: Work, out: Path, wanted: Mapping[Any, Any], result: Any) -> str:
    """Return in what a folder at the end is not as undisturbed work leaves it."""
    try:
        kept, found = dict(work.kept(out)), work.result(out)
    except Exception as error:
        return repr(error)
    names = [name for name in {**wanted, **kept} if wanted.get(name) != kept.get(name)]
    if names:
        return f"{names[0]} and in all {len(names)} of {len(wanted)}"
    return "" if found == result else f"result {found} in place of {result}"


def _started(work: Work, out: Path) -> int:
    """Begin work, or go on with it, in a process of its own, and return that."""
    child = os.fork()
    if child:
        return child
    # As a spawned worker has it: a pool ends the rest of its workers in this manner.
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    try:
        work.go_on(out)
    except BaseException:
        write_text(_error_of(out), traceback.format_exc())
        os._exit(_FAILED)
    os._exit(0)


def _error_of(out: Path) -> Path:
    """Return the path of what is known of an error beside a folder."""
    return out.with_name(f"{out.name}.error")


def _told(out: Path) -> str:
    """Return the last line of the error with which work in a folder ended."""
    path = _error_of(out)
    return path.read_text().strip().splitlines()[-1] if path.exists() else "it died"


def _ended(run: int, seconds: float = float("inf")) -> int | None:
    """Wait for a process, and return its exit status; None if it has not ended in time."""
    end = time.monotonic() + seconds
    try:
        while time.monotonic() < end:
            ended, status = os.waitpid(run, os.WNOHANG)
            if ended:
                return os.waitstatus_to_exitcode(status)
            time.sleep(0.002)
    except BaseException:
        # Whoever interrupts leaves nothing running.
        os.kill(run, signal.SIGKILL)
        raise
    return None


def _killed_after(
    run: int, seconds: float, rng: np.random.Generator
) -> tuple[str, list[psutil.Process]]:
    """Kill a process, or one that it began, after a time.

    Returns:
        Which was killed, "failed" if it failed before, or nothing if it ended well before; and the
        processes that it had begun.
    """
    status = _ended(run, seconds)
    if status is not None:
        return "failed" if status else "", []
    main = victim = psutil.Process(run)
    others: list[psutil.Process] = []
    with suppress(psutil.NoSuchProcess):
        # While it stands still it begins no more.
        main.suspend()
        others = main.children(recursive=True)
        if others and rng.random() < 0.5:
            victim = others[int(rng.integers(len(others)))]
        victim.kill()
    with suppress(psutil.NoSuchProcess):
        main.resume()
    _ended(run)
    return "the first process" if victim is main else "a worker", others
