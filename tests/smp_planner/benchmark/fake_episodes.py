"""Rows without an environment, for tests of what is done with rows."""

import dataclasses
import os
import signal
import time
from typing import Any

import numpy as np

from smp_gym.suites import Cell
from smp_planner.benchmark.episodes import EpisodeKey, EpisodeRow
from smp_planner.benchmark.manifest import Manifest

MEDIUM, HARD = Cell("Placement", "medium"), Cell("Placement", "hard")


def fake_play(key: EpisodeKey) -> EpisodeRow:
    """Return a row that follows from the key, without an environment."""
    draw = np.random.default_rng([key.seed, len(key.method)])
    success = bool(draw.random() < 0.7)
    return EpisodeRow(
        task=key.task,
        method=key.method,
        difficulty=key.difficulty,
        seed=key.seed,
        success=success,
        collision=not success,
        cause="" if success else "collision",
        contact="" if success else "palm – obstacle_0",
        goal_error=float(draw.random()),
        path_length=1.0 + float(draw.random()),
        clearance=0.02,
        steps=int(draw.integers(100, 400)),
        half=key.half,
        family=key.family,
        sensing=key.sensing,
        noise=key.noise,
        share_collision_free=float(draw.random()),
        planning_time=time.perf_counter() % 1.0,
        episode_time=0.1,
        stage_times={"map": 0.01, "inference": 0.2},
        scene=f'{{"seed": {key.seed}}}' * 50,
    )


def fails_at_seed_two(key: EpisodeKey) -> EpisodeRow:
    if key.seed == 2:
        raise ValueError("a goal out of reach")
    return fake_play(key)


def is_killed_at_seed_two(key: EpisodeKey) -> EpisodeRow:
    if key.seed == 2:
        os.kill(os.getpid(), signal.SIGKILL)
    return fake_play(key)


def slow_play(key: EpisodeKey) -> EpisodeRow:
    time.sleep(0.3)
    return fake_play(key)


def manifest(episodes: int = 4, **changes: Any) -> Manifest:
    made = Manifest((MEDIUM,), ("smp", "promp"), 0, episodes, {"numpy": "2"}, "abc")
    return dataclasses.replace(made, **changes)


def without_times(rows: list[EpisodeRow]) -> list[EpisodeRow]:
    """Return rows, sorted, without what differs from run to run."""
    times = {"replanning_time": 0.0, "planning_time": 0.0, "episode_time": 0.0, "stage_times": {}}
    return sorted((dataclasses.replace(row, **times) for row in rows), key=lambda row: row.key)
