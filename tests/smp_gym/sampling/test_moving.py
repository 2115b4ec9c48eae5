"""Families "moving" and "displaced": paths, reference trajectories in time."""

from __future__ import annotations

import warnings
from functools import cache

import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from smp_gym.arrays import FloatArray
from smp_gym.inspection.checking import make, play_digest
from smp_gym.observation import CONTROL_PERIOD, MAX_EPISODE_STEPS
from smp_gym.rollout import play
from smp_gym.sampling import sample_scene, sample_with_witness
from smp_gym.sampling.displaced import SHIFT_TIME, SHIFTS
from smp_gym.sampling.in_time import clears_in_time, delayed, held_on, ticks_of
from smp_gym.sampling.moving import SPEEDS
from smp_gym.scene import Obstacle, Scene

CASES = [("Placement", "medium", 0), ("Placement", "hard", 2), ("DoubleSidedPlacement", "easy", 1)]


@cache
def _drawn(task: str, family: str, difficulty: str, seed: int) -> tuple[Scene, FloatArray]:
    """Return a scene and its reference trajectory, drawn once for all tests."""
    return sample_with_witness(task, difficulty, seed, family)


def _moving(scene: Scene) -> list[Obstacle]:
    return [obstacle for obstacle in scene.obstacles if obstacle.motion is not None]


@pytest.mark.parametrize(("task", "difficulty", "seed"), CASES)
def test_bodies_keep_their_speed_for_the_whole_horizon(
    task: str, difficulty: str, seed: int
) -> None:
    scene, _ = _drawn(task, "moving", difficulty, seed)
    moving = _moving(scene)
    assert 1 <= len(moving) <= 2
    times = np.arange(MAX_EPISODE_STEPS + 1) * CONTROL_PERIOD
    for obstacle in moving:
        speeds = [np.linalg.norm(obstacle.at(float(time))[1]) for time in times]
        np.testing.assert_allclose(speeds, SPEEDS[difficulty], rtol=0.1)
        np.testing.assert_allclose(np.linalg.norm(obstacle.velocity), SPEEDS[difficulty], rtol=0.1)


@pytest.mark.parametrize(("difficulty", "seed"), [("easy", 0), ("medium", 0), ("hard", 3)])
def test_shifts_are_as_long_as_the_difficulty_says(difficulty: str, seed: int) -> None:
    scene, _ = _drawn("Placement", "displaced", difficulty, seed)
    shifted = _moving(scene)
    assert 1 <= len(shifted) <= 2
    low, high = SHIFTS[difficulty]
    for obstacle in shifted:
        assert obstacle.motion is not None
        _, begin, end = obstacle.motion.times
        assert begin > 0.0
        assert end - begin == pytest.approx(SHIFT_TIME)
        shift = np.linalg.norm(obstacle.at(end)[0] - np.array(obstacle.position))
        assert low - 1e-9 <= shift <= high + 1e-9
        np.testing.assert_array_equal(obstacle.at(begin)[0], obstacle.position)
        np.testing.assert_array_equal(obstacle.velocity, np.zeros(3))


@pytest.mark.parametrize("family", ["moving", "displaced"])
def test_scenes_are_pure_functions_and_survive_json(family: str) -> None:
    scene, _ = _drawn("Placement", family, "medium", 0)
    assert sample_scene("Placement", "medium", 0, family) == scene
    assert Scene.from_json(scene.to_json()) == scene
    assert scene.family == family


@pytest.mark.parametrize(
    ("task", "family", "difficulty", "seed"),
    [(task, "moving", difficulty, seed) for task, difficulty, seed in CASES]
    + [("Placement", "displaced", "medium", 0), ("Placement", "displaced", "hard", 3)],
)
def test_reference_trajectory_in_time_succeeds_in_the_physics(
    task: str, family: str, difficulty: str, seed: int
) -> None:
    scene, witness = _drawn(task, family, difficulty, seed)
    env = make(f"smp_gym/{task}-v0", difficulty="none")
    info = play(env, scene, witness)
    env.close()
    assert info["is_success"], info
    assert info["clearance"] > 0.0


def test_reference_trajectory_does_not_get_by_at_every_time() -> None:
    """Executed at another time it is struck."""
    scene, witness = _drawn("Placement", "moving", "hard", 2)
    env = make("smp_gym/Placement-v0", difficulty="none")
    outcomes = (play(env, scene, delayed(witness, d))["failure"] for d in (1.0, 2.0, 3.0, 4.0))
    assert "collision" in outcomes
    env.close()


def test_delayed_waits_and_then_executes_the_same() -> None:
    phase = np.linspace(0.0, 1.0, 200)[:, None]
    trajectory = np.repeat(0.5 * np.sin(phase * np.pi / 2), 6, axis=1)
    waited = delayed(trajectory, 4.0)
    standing = np.abs(waited - trajectory[0]).max(axis=1) < 1e-12
    # 0.5 rad * pi / 2 at 0.9 of the slowest joint's limit, and 4 s before.
    moving = 0.5 * np.pi / 2 / (0.9 * np.pi / 5)
    assert standing.mean() == pytest.approx(4.0 / (4.0 + moving), abs=0.02)
    np.testing.assert_allclose(waited[-1], trajectory[-1])


def test_clearance_in_time_agrees_with_spheres_at_each_moment() -> None:
    """A ball that moves along x against one sphere that moves along y, in closed form."""
    times = np.arange(41) * CONTROL_PERIOD
    path = np.stack([np.zeros(41), 0.3 * times - 0.3, np.zeros(41)], axis=1)[None, :, None]
    track = np.stack([0.2 * np.arange(81) * CONTROL_PERIOD - 0.3] + [np.zeros(81)] * 2, axis=1)
    row = np.array([[2.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.03, 0.03, 0.03]])
    for offset in (0, 5, 10, 20):
        at = np.minimum(np.arange(41 + 10), 40)
        moment = ticks_of(times[None])[0] + offset
        gaps = np.linalg.norm(path[0, at, 0] - track[np.minimum(moment, 80)], axis=1)
        least = gaps.min() - 0.03 - 0.02
        for clearance in (least - 1e-6, least + 1e-6):
            clears = clears_in_time(
                held_on(path),
                np.array([0.02]),
                ticks_of(times[None]),
                offset,
                row,
                track[None],
                clearance,
            )
            assert clears[0, 0] == (clearance < least)


def test_environments_pass_the_checks_and_repeat() -> None:
    scene, _ = _drawn("Placement", "moving", "medium", 0)
    env = make("smp_gym/Placement-v0", difficulty="medium", family="moving")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env, skip_render_check=True)
    env.reset(seed=0)
    assert env.scene == scene
    first, _ = play_digest(env, scene)
    play_digest(env, _drawn("Placement", "displaced", "medium", 0)[0])
    again, _ = play_digest(env, scene)
    assert again == first
    env.close()
