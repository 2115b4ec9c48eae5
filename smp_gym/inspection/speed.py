"""Throughput of environments: steps and resets a second, alone and in several processes.

Beside them stands `PandaPickAndPlace-v3` of panda-gym, if that is installed (``pip install
smp-gym[panda]``). Actions are random; steps a second leave out the resets in between.
"""

from __future__ import annotations

import importlib.util
import multiprocessing
import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np

import smp_gym
from smp_gym.processes import end_with_parent
from smp_gym.scene import Scene

__all__ = ["PANDA", "Speed", "known_ids", "together"]

PANDA = "PandaPickAndPlace-v3"
_THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@dataclass(frozen=True)
class Speed:
    """The throughput of one process.

    Attributes:
        steps: a second.
        replays: resets to a given scene a second; of panda-gym, any resets.
        draws: resets to a newly drawn scene a second; of panda-gym, any resets.
    """

    steps: float
    replays: float
    draws: float


def _rate(act: Callable[[], float], seconds: float) -> float:
    """Call again and again until the calls' own times, which they return, add up to `seconds`."""
    count, spent = 0, 0.0
    while spent < seconds:
        spent += act()
        count += 1
    return count / spent


def _timed(act: Callable[[], Any]) -> float:
    began = time.perf_counter()
    act()
    return time.perf_counter() - began


def _measure(id: str, seconds: float, barrier: Any, results: Any) -> None:
    """Measure one environment in this process, at the same time as the others at the barrier."""
    end_with_parent()
    if id == PANDA:
        import panda_gym  # noqa: F401  (registers the environment)
    env = gymnasium.make(id)
    env.reset(seed=0)
    env.action_space.seed(0)
    scene: Scene | None = getattr(env.unwrapped, "scene", None)
    seeds = iter(range(10**6))
    over = True

    def step() -> float:
        nonlocal over
        if over:
            env.reset(seed=next(seeds))
        action = env.action_space.sample()
        began = time.perf_counter()
        _, _, terminated, truncated, _ = env.step(action)
        over = terminated or truncated
        return time.perf_counter() - began

    def replay() -> float:
        return _timed(lambda: env.reset(options={"scene": scene} if scene else None))

    def draw() -> float:
        return _timed(lambda: env.reset(seed=next(seeds)))

    for act in (step, replay, draw):
        act()
    rates = []
    for act in (step, replay, draw):
        barrier.wait()
        rates.append(_rate(act, seconds))
    env.close()
    results.put(Speed(*rates))


def known_ids() -> list[str]:
    """Return the ids that can be measured: ours, and `PANDA` where panda-gym is installed."""
    ids = [entry.id for entry in smp_gym.ENVIRONMENTS]
    return [*ids, PANDA] if importlib.util.find_spec("panda_gym") else ids


def together(id: str, processes: int, seconds: float) -> Speed:
    """Return what several processes reach together, each with an environment of its own.

    Args:
        id: of `known_ids`.
        processes: how many, at least 1.
        seconds: length of each of the three measurements.
    """
    os.environ.update(dict.fromkeys(_THREAD_VARIABLES, "1"))
    context = multiprocessing.get_context("spawn")
    barrier, results = context.Barrier(processes), context.Queue()
    workers = [
        context.Process(target=_measure, args=(id, seconds, barrier, results), daemon=True)
        for _ in range(processes)
    ]
    for worker in workers:
        worker.start()
    speeds = [results.get(timeout=60.0 + 20.0 * seconds) for _ in workers]
    for worker in workers:
        worker.join()
    names = ("steps", "replays", "draws")
    return Speed(*(float(np.sum([getattr(speed, name) for speed in speeds])) for name in names))
