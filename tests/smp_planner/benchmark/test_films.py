"""Films of episodes: what they show, held against the episode and a pinhole camera."""

from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from smp_gym.geometry.distance import local_distance
from smp_gym.scene import Scene
from smp_gym.suites import Cell
from smp_planner.benchmark.episode_pictures import planned_path
from smp_planner.benchmark.episodes import (
    EpisodeKey,
    PlayedEpisode,
    PlayMethods,
    environment_id,
    play_episode,
)
from smp_planner.benchmark.films import ActionRecorder, film, outcome

# The unadapted primitive runs into an obstacle within a second here.
COLLIDES = EpisodeKey.of(Cell("Placement", "medium"), "promp", 73000)
HEIGHT = 180


@pytest.fixture(scope="module")
def played() -> tuple[PlayedEpisode, ActionRecorder]:
    env, recorder = gym.make(environment_id("Placement")), ActionRecorder()
    player = PlayMethods()
    episode = play_episode(COLLIDES, env, player.policy(COLLIDES), (recorder,))
    env.close()
    return episode, recorder


@pytest.fixture(scope="module")
def frames(played: tuple[PlayedEpisode, ActionRecorder]) -> list[NDArray[np.uint8]]:
    episode, recorder = played
    return film(episode, recorder.actions, planned_path(episode), HEIGHT)


def _near(picture: NDArray[np.uint8], color: tuple[int, int, int]) -> NDArray[np.bool_]:
    return np.abs(picture.astype(int) - color).max(axis=-1) < 30


def test_a_film_has_a_picture_for_each_step(
    played: tuple[PlayedEpisode, ActionRecorder], frames: list[NDArray[np.uint8]]
) -> None:
    assert len(frames) == played[0].row.steps + 1
    assert {frame.shape for frame in frames} == {(HEIGHT, HEIGHT * 16 // 9, 3)}


def test_the_planned_path_is_drawn(
    played: tuple[PlayedEpisode, ActionRecorder], frames: list[NDArray[np.uint8]]
) -> None:
    episode, recorder = played
    without = film(episode, recorder.actions, None, HEIGHT)
    changed = (frames[0] != without[0]).any(axis=-1)[:160]
    assert changed.sum() > 100
    assert _near(frames[0][:160], (245, 158, 10))[changed].mean() > 0.95


def test_the_contact_is_where_arm_and_obstacle_meet(
    played: tuple[PlayedEpisode, ActionRecorder], frames: list[NDArray[np.uint8]]
) -> None:
    episode, recorder = played
    scene = Scene.model_validate_json(episode.row.scene)
    env = gym.make(environment_id("Placement"))
    env.reset(options={"scene": scene})
    for action in recorder.actions:
        assert env.get_wrapper_attr("collision_point") is None
        env.step(action)
    point = env.get_wrapper_attr("collision_point")
    hit = scene.obstacles[int(episode.row.contact.rpartition("obstacle_")[2])]
    local = Rotation.from_quat(hit.quaternion).inv().apply(point - hit.position)
    distance = local_distance(local[None], hit.shape, np.array([hit.size]))
    assert abs(float(distance[0])) < 0.005
    env.reset(options={"scene": scene})
    assert env.get_wrapper_attr("collision_point") is None
    env.close()

    # A pinhole at the film's camera: yaw 62 degrees, pitch -28, 45 degrees from top to bottom.
    yaw, pitch = np.deg2rad([62.0, -28.0])
    ahead = np.array([-np.sin(yaw) * np.cos(pitch), np.cos(yaw) * np.cos(pitch), np.sin(pitch)])
    right = np.array([np.cos(yaw), np.sin(yaw), 0.0])
    offset = point - ((0.32, 0.0, 0.36) - 1.65 * ahead)
    scale = 166 / 2 / np.tan(np.deg2rad(22.5)) / (offset @ ahead)
    place = np.array([160 + scale * offset @ right, 83 - scale * offset @ np.cross(right, ahead)])
    red = _near(frames[-1], (196, 26, 26))
    red[:3] = red[160:] = red[:, :3] = red[:, -3:] = False
    ring = np.argwhere(red)[:, ::-1]
    np.testing.assert_allclose((ring.min(axis=0) + ring.max(axis=0)) / 2, place, atol=3.0)
    assert not _near(frames[0], (196, 26, 26))[3:160, 3:-3].any()


def test_the_caption_changes_with_time_and_outcome(frames: list[NDArray[np.uint8]]) -> None:
    captions = [frame[166:, 4:-4] for frame in frames]
    assert (captions[0] != captions[2]).any()
    # Light letters on a dark ground at first, and letters of a failure's colour at last.
    assert captions[0].min() < 60
    assert captions[0].max() > 230
    assert _near(captions[-1][:-2], (252, 165, 165)).any()
    assert not _near(captions[0], (252, 165, 165)).any()


def test_outcomes_in_words(played: tuple[PlayedEpisode, ActionRecorder]) -> None:
    row = played[0].row
    assert outcome(replace(row, contact="j2s6s200_link_6 – obstacle_2", steps=16)) == (
        "collision, link 6 – obstacle 2, after 0.8 s"
    )
    assert outcome(replace(row, success=True, steps=114)) == "success after 5.7 s"
    assert outcome(replace(row, cause="timeout", contact="", steps=400)) == (
        "timeout, after 20.0 s"
    )


def test_actions_of_another_episode_are_refused(
    played: tuple[PlayedEpisode, ActionRecorder],
) -> None:
    episode, recorder = played
    with pytest.raises(RuntimeError, match="lead elsewhere"):
        film(episode, recorder.actions[:-2], None, HEIGHT)
