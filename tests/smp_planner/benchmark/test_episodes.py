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
from smp_gym.datasets.frozen import FrozenEpisode, list_path, write_episodes
from smp_gym.sampling import place_without_witness, sample_scene
from smp_gym.suites import Cell
from smp_planner.benchmark.cli import app
from smp_planner.benchmark.episode_pictures import object_paths
from smp_planner.benchmark.episodes import EpisodeKey, PlayedEpisode, environment_id, play_episode
from smp_planner.benchmark.manifest import read_results
from smp_planner.benchmark.summary import write_csv
from smp_planner.policy.planner_policy import PlannerPolicy

TIMES = ("replanning_time", "planning_time", "episode_time")


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
        assert len(rollout.scene.obstacles) == len(scene.obstacles) > 0
        for met, drawn in zip(rollout.scene.obstacles, scene.obstacles, strict=True):
            np.testing.assert_allclose(met.position, drawn.position, atol=1e-6)
            np.testing.assert_allclose(met.size, drawn.size, atol=1e-6)


def test_an_episode_of_a_frozen_list_is_the_stored_one(
    env: gym.Env[Any, Any], tmp_path: Path
) -> None:
    cell = Cell("Placement", "hard")
    stored = place_without_witness("Placement", "hard", 3)
    episodes = [FrozenEpisode("placed", 3, stored, "smp")]
    write_episodes(list_path(cell, tmp_path), {}, episodes)
    key = EpisodeKey.of(cell, "promp", 3, "placed")
    policy = PlannerPolicy.make("promp", "Placement")
    rollout = play_episode(key, env, policy, lists=tmp_path)
    assert rollout.row.key == key
    assert rollout.row.half == "placed"
    assert len(rollout.scene.obstacles) == len(stored.obstacles)
    for met, drawn in zip(rollout.scene.obstacles, stored.obstacles, strict=True):
        np.testing.assert_allclose(met.position, drawn.position, atol=1e-6)
    unknown = EpisodeKey.of(cell, "promp", 5, "witness")
    with pytest.raises(ValueError, match="seed=5"):
        play_episode(unknown, env, policy, lists=tmp_path)


def test_the_command_plays_the_lists_of_a_suite(tmp_path: Path) -> None:
    cells = [Cell("Placement", "easy"), Cell("Placement", "easy", "shelf")]
    for cell in cells:
        seeds = (7, 9) if cell.family == "obstacles" else (7,)
        episodes = [FrozenEpisode("witness", seed, cell.scene(seed), "smp") for seed in seeds]
        write_episodes(list_path(cell, tmp_path / "lists"), {}, episodes)
    out = tmp_path / "out"
    common = ["run", "--suite", "standard", "--lists", str(tmp_path / "lists"), "--jobs", "1"]
    own = ["--cells", "Placement_easy", "--methods", "promp", "--episodes", "2", "--out", str(out)]
    result = CliRunner().invoke(app, [*common, *own])
    assert result.exit_code == 0, result.output
    assert "Placement_easy, frozen list" in result.output
    manifest, rows = read_results(out)
    assert (manifest.suite, manifest.cells) == ("standard", (cells[0],))
    assert [(row.seed, row.half) for row in rows] == [(7, "witness"), (9, "witness")]
    assert not list(out.glob("*.png"))


def test_the_command_makes_plans_anew_and_rows_say_so(tmp_path: Path) -> None:
    out = tmp_path / "out"
    common = ["run", "--jobs", "1", "--no-figure", "--no-video", "--difficulty", "none"]
    common += ["--episodes", "1", "--seed", "3", "--out", str(out)]
    own = ["--methods", "promp", "--replan-every", "15", "--latency", "3"]
    result = CliRunner().invoke(app, [*common, *own])
    assert result.exit_code == 0, result.output
    assert "replanning: every, latency, steps" in result.output
    manifest, (row,) = read_results(out)
    assert (manifest.replan_every, manifest.latency) == (15, 3)
    assert (row.replan_every, row.latency) == (15, 3)
    assert row.success
    assert 3 <= row.replans <= row.steps // 15
    assert 0.0 < row.replanning_time < row.episode_time
    assert row.seed == 3
    assert not [*out.glob("*.png"), *out.glob("*.mp4")]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--latency", "3"], "--latency needs --replan-every"),
        (["--methods", "cpromp", "--replan-every", "5"], "can go on from a plan"),
        (["--methods", "rrt_connect", "--replan-every", "5"], "can go on from a plan"),
    ],
)
def test_the_command_refuses_replanning_that_cannot_be(
    tmp_path: Path, arguments: list[str], message: str
) -> None:
    result = CliRunner().invoke(app, ["run", "--out", str(tmp_path / "out"), *arguments])
    assert result.exit_code == 2
    assert message in " ".join(result.output.split())


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


def test_the_command_from_start_to_end(rollouts: dict[str, PlayedEpisode], tmp_path: Path) -> None:
    out = tmp_path / "out"
    options = ["--methods", "smp", "--seed", "5", "--episodes", "1", "--jobs", "2"]
    options += ["--out", str(out)]
    result = CliRunner().invoke(app, ["run", *options])
    assert result.exit_code == 0, result.output
    for name in (
        "episodes.csv",
        "summary.json",
        "scene_Placement_medium_smp.png",
        "episode_Placement_medium_smp.mp4",
    ):
        assert (out / name).stat().st_size > 0
        assert name in result.output.replace("\n", "")
    with imageio.get_reader(out / "episode_Placement_medium_smp.mp4") as reader:
        assert reader.count_frames() > 60
    summary = json.loads((out / "summary.json").read_text())
    assert summary["map"]["inside_occupied"] >= 0.99
    assert [group["episodes"] for group in summary["groups"]] == [1]

    # A worker writes the row of this process.
    write_csv(tmp_path / "here.csv", [rollouts["smp"].row])
    assert _rows(out / "episodes.csv") == _rows(tmp_path / "here.csv")
