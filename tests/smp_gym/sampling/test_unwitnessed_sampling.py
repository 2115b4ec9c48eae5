"""Scenes placed without a witness: what they block, and what they leave clear."""

import numpy as np
import pytest

from smp_gym.env import ManipulationEnv
from smp_gym.robot import kinematics
from smp_gym.sampling import SPECIFICATIONS, place_without_witness, sample_scene
from smp_gym.sampling.obstacles import START_CLEARANCE
from smp_gym.sampling.transfer import carry, release_configuration
from smp_gym.tasks.placement.scenes import demonstrated_transfer
from smp_gym.tasks.push_lift_box.scenes import PLACED

CROWDED = ("easy", "medium", "hard")
easy, medium, hard = (SPECIFICATIONS[difficulty].obstacles for difficulty in CROWDED)


@pytest.mark.parametrize("difficulty", CROWDED)
def test_a_scene_is_a_function_of_its_seed(difficulty):
    scenes = [place_without_witness("Placement", difficulty, seed) for seed in (3, 4, 3)]
    assert scenes[0] == scenes[2]
    assert scenes[0] != scenes[1]
    assert scenes[0] != sample_scene("Placement", difficulty, 3)
    for scene in scenes:
        assert len(scene.obstacles) == SPECIFICATIONS[difficulty].obstacles
        assert (scene.difficulty, scene.seed) == (difficulty, None)


def distances(points, obstacle):
    """Return signed distances of points (..., 3) to an upright obstacle."""
    _, _, z, w = obstacle.quaternion
    yaw = 2 * np.arctan2(z, w)
    offset = points - np.array(obstacle.position)
    turned = np.stack(
        [
            np.cos(yaw) * offset[..., 0] + np.sin(yaw) * offset[..., 1],
            np.cos(yaw) * offset[..., 1] - np.sin(yaw) * offset[..., 0],
            offset[..., 2],
        ],
        axis=-1,
    )
    size = np.array(obstacle.size)
    if obstacle.shape == "sphere":
        return np.linalg.norm(turned, axis=-1) - size[0]
    if obstacle.shape == "cylinder":
        flat = np.linalg.norm(turned[..., :2], axis=-1)
        beyond = np.stack([flat, np.abs(turned[..., 2])], axis=-1) - size[[0, 2]]
    else:
        beyond = np.abs(turned) - size
    outside = np.linalg.norm(np.maximum(beyond, 0.0), axis=-1)
    return outside + np.minimum(beyond.max(axis=-1), 0.0)


@pytest.mark.parametrize("difficulty", CROWDED)
def test_the_mean_is_blocked_and_its_ends_are_free(difficulty):
    data = demonstrated_transfer()
    for seed in range(5):
        scene = place_without_witness("Placement", difficulty, seed)
        end = release_configuration(data, scene.goals[0])
        mean = carry(data, end, 200).mean(axis=0)
        centers = kinematics.sphere_centers(mean, data.spheres)
        gaps = np.min([distances(centers, o) for o in scene.obstacles], axis=0)
        gaps = (gaps - data.spheres.radius).min(axis=1)
        assert gaps.min() < -0.015
        assert gaps[[0, -1]].min() > START_CLEARANCE - 0.001
        env = ManipulationEnv()
        env.reset(options={"scene": scene})
        env.close()


@pytest.mark.parametrize(
    ("task", "counts"),
    [
        ("DoubleSidedPlacement", [2 * easy, 2 * medium, hard + 1]),
        ("PushLiftBox", [PLACED[difficulty][0] for difficulty in CROWDED]),
    ],
)
def test_every_task_gives_playable_scenes_that_are_functions_of_their_seed(task, counts):
    env = ManipulationEnv(task)
    for difficulty, count in zip(CROWDED, counts, strict=True):
        scene = place_without_witness(task, difficulty, 1)
        assert scene == place_without_witness(task, difficulty, 1)
        assert scene != place_without_witness(task, difficulty, 2)
        assert len(scene.obstacles) == count
        assert (scene.task, scene.difficulty, scene.seed) == (task, difficulty, None)
        env.reset(options={"scene": scene})
    env.close()


def test_bad_arguments_list_what_exists():
    with pytest.raises(ValueError, match="Placement"):
        place_without_witness("Juggling", "easy", 0)
    with pytest.raises(ValueError, match="easy, medium, hard; got 'none'"):
        place_without_witness("Placement", "none", 0)
    with pytest.raises(ValueError, match="-1"):
        place_without_witness("Placement", "easy", -1)
