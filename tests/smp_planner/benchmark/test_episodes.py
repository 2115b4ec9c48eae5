"""Episodes of the benchmark in the real environments, with the real planners, end to end."""

import csv
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gymnasium as gym
import imageio.v2 as imageio
import numpy as np
import pytest
from typer.testing import CliRunner

import smp_gym  # noqa: F401  (registers the environments)
from smp_gym.datasets.frozen import load_episodes
from smp_gym.sampling import sample_scene
from smp_planner.benchmark.cli import app
from smp_planner.benchmark.episode_pictures import object_paths
from smp_planner.benchmark.episodes import EpisodeKey, PlayedEpisode, environment_id, play_episode
from smp_planner.benchmark.manifest import read_results
from smp_planner.policy.planner_policy import PlannerPolicy

TIMES = ("planning_time", "episode_time")


@pytest.fixture(scope="module")
def env() -> Iterator[gym.Env[Any, Any]]:
    made = gym.make(environment_id("Placement"), difficulty="medium")
    yield made
    made.close()


@pytest.fixture(scope="module")
def rollouts(env: gym.Env[Any, Any]) -> dict[str, PlayedEpisode]:
    return {
        method: play_episode(
            EpisodeKey("Placement", method, "medium", 5),
            env,
            PlannerPolicy.make(method, "Placement"),
        )
        for method in ("smp", "promp")
    }


def test_methods_meet_the_scene_of_the_seed(rollouts: dict[str, PlayedEpisode]) -> None:
    scene = sample_scene("Placement", "medium", 5)
    for rollout in rollouts.values():
        assert len(rollout.scene.obstacles) == len(scene.obstacles) == 4
        for met, drawn in zip(rollout.scene.obstacles, scene.obstacles, strict=True):
            np.testing.assert_allclose(met.position, drawn.position, atol=1e-6)
            np.testing.assert_allclose(met.size, drawn.size, atol=1e-6)


def test_an_episode_of_a_frozen_list_is_the_stored_one(env: gym.Env[Any, Any]) -> None:
    episode = load_episodes("Placement", "hard")[1]
    key = EpisodeKey("Placement", "promp", "hard", episode.seed, episode.half)
    rollout = play_episode(key, env, PlannerPolicy.make("promp", "Placement"))
    assert rollout.row.key == key
    assert rollout.row.half == "certified"
    assert len(rollout.scene.obstacles) == 6
    for met, stored in zip(rollout.scene.obstacles, episode.scene.obstacles, strict=True):
        np.testing.assert_allclose(met.position, stored.position, atol=1e-6)
    unknown = EpisodeKey("Placement", "promp", "hard", 5, "witness")
    with pytest.raises(ValueError, match="seed=5"):
        play_episode(unknown, env, PlannerPolicy.make("promp", "Placement"))


def test_rows_say_what_the_plan_says(rollouts: dict[str, PlayedEpisode]) -> None:
    for rollout in rollouts.values():
        row, plan = rollout.row, rollout.plan
        both = [bool(a and b) for a, b in zip(plan.collision_free, plan.executable, strict=True)]
        assert row.share_good == pytest.approx(sum(both) / len(both))
        assert row.chosen_collision_free == plan.collision_free[plan.chosen]
        assert row.planning_time == pytest.approx(sum(plan.timings.values()))
        assert row.planning_time < row.episode_time


def test_rows_say_what_happened(rollouts: dict[str, PlayedEpisode]) -> None:
    for rollout in rollouts.values():
        row, path = rollout.row, rollout.object_path
        assert len(path) == row.steps + 1 <= 401
        x, y, z = rollout.scene.goals[0].position
        rest = (x, y, z + rollout.scene.manipulated.size[2])  # type: ignore[union-attr]
        assert row.goal_error == pytest.approx(np.linalg.norm(path[-1] - rest), abs=1e-9)
        assert row.success is (row.cause == "")
        assert row.collision is (row.contact != "")
        assert not (row.success and row.collision)
        if row.success:
            assert row.goal_error < 0.12
            assert row.path_length > 0.6


def test_lines_of_the_figure_pass_where_the_object_is_held(
    rollouts: dict[str, PlayedEpisode],
) -> None:
    for rollout in rollouts.values():
        begin = object_paths(np.array(rollout.scene.start))
        np.testing.assert_allclose(begin, rollout.object_path[0], atol=0.01)


def _rows(path: Path) -> list[dict[str, str]]:
    with path.open() as file:
        return [{k: v for k, v in row.items() if k not in TIMES} for row in csv.DictReader(file)]


def test_the_command_from_start_to_end(tmp_path: Path) -> None:
    def bench(out: str, *options: str) -> str:
        common = ["run", "--seed", "40", "--difficulty", "easy", "--out", str(tmp_path / out)]
        result = CliRunner().invoke(app, [*common, *options])
        assert result.exit_code == 0, result.output
        return result.output

    output = bench("two", "--episodes", "2", "--jobs", "2")
    for name in (
        "episodes.csv",
        "summary.json",
        "scene_Placement_smp.png",
        "scene_Placement_promp.png",
        "episode_Placement_smp.mp4",
        "episode_Placement_promp.mp4",
    ):
        assert (tmp_path / "two" / name).stat().st_size > 0
        assert name in output.replace("\n", "")
    with imageio.get_reader(tmp_path / "two" / "episode_Placement_smp.mp4") as reader:
        assert reader.count_frames() > 60
    summary = json.loads((tmp_path / "two" / "summary.json").read_text())
    assert summary["map"]["inside_occupied"] >= 0.99
    assert [group["episodes"] for group in summary["groups"]] == [2, 2]

    # One worker writes the same rows as two.
    bench("one", "--episodes", "2", "--jobs", "1", "--no-figure", "--no-video")
    assert _rows(tmp_path / "one" / "episodes.csv") == _rows(tmp_path / "two" / "episodes.csv")
    assert not list((tmp_path / "one").glob("*.png"))
    assert {row.seed for row in read_results(tmp_path / "one")[1]} == {40, 41}
