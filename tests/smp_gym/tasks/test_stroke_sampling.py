"""Scenes of DrawS: what they are, their witnesses in the physics, and what they block."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from smp_gym.datasets.demonstrations import Demonstrations
from smp_gym.env import ManipulationEnv
from smp_gym.robot import kinematics
from smp_gym.robot.pen import pen_path
from smp_gym.rollout import play
from smp_gym.sampling import (
    place_without_witness,
    sample_scene,
    sample_with_witness,
)
from smp_gym.scene import DIFFICULTIES, STROKE_POINTS, Scene
from smp_gym.tasks.draw_s.rules import covered
from smp_gym.tasks.draw_s.scenes import SPECIFICATIONS
from smp_gym.tasks.draw_s.stroke_trajectories import SCALE, drawing_body, sample_stroke, tip_path
from smp_gym.tasks.draw_s.strokes import follow, moved

SEEDS = range(6)
CROWDED = ("easy", "medium", "hard")
LINE = np.linspace([0.4, -0.3, 0.3], [0.5, 0.4, 0.2], STROKE_POINTS)


@pytest.fixture(scope="module")
def env():
    made = ManipulationEnv("DrawS")
    yield made
    made.close()


def test_moved_strokes_are_similar_and_end_where_told():
    line = moved(LINE, (0.1, 0.2, 0.3), 1.1, 0.25)
    np.testing.assert_allclose(line[-1], [0.1, 0.2, 0.3], atol=1e-12)
    turned = Rotation.from_euler("z", 0.25).apply(LINE[0] - LINE[-1])
    np.testing.assert_allclose(line[0] - line[-1], 1.1 * turned, atol=1e-12)


def test_following_reaches_every_point_with_little_change():
    q = Demonstrations.load("DrawS").configurations[0]
    target = pen_path(q) + np.array([0.02, -0.03, 0.02])
    found, error = follow(target, q)
    assert error < 1e-4
    np.testing.assert_allclose(pen_path(found), target, atol=1e-4)
    assert np.abs(found - q).max() < 0.3


@pytest.fixture(scope="module")
def drawn():
    return {d: [sample_with_witness("DrawS", d, seed) for seed in SEEDS] for d in DIFFICULTIES}


@pytest.mark.parametrize("difficulty", DIFFICULTIES)
def test_scenes_are_what_the_difficulty_says(drawn, difficulty):
    template = Demonstrations.load("DrawS").pen_paths.mean(axis=0)
    length = np.linalg.norm(np.diff(template, axis=0), axis=1).sum()
    for scene, witness in drawn[difficulty]:
        stroke = scene.goals[0]
        points = np.array(stroke.checkpoints)
        assert len(scene.obstacles) == SPECIFICATIONS[difficulty].obstacles
        hidden = covered(points, scene.obstacles)
        np.testing.assert_array_equal(hidden, ~np.array(stroke.demanded))
        assert hidden.any() == (difficulty != "none")
        assert not hidden[[0, -1]].any()
        assert hidden.mean() <= 0.6
        scale = np.linalg.norm(np.diff(points, axis=0), axis=1).sum() / length
        assert SCALE[0] - 0.02 < scale < SCALE[1] + 0.02
        np.testing.assert_array_equal(witness[0], scene.start)
        assert np.linalg.norm(pen_path(witness[0]) - points[0]) <= 0.021
        assert Scene.from_json(scene.to_json()) == scene


@pytest.mark.parametrize("difficulty", DIFFICULTIES)
def test_witnesses_solve_their_scenes_in_the_physics(drawn, difficulty, env):
    for scene, witness in drawn[difficulty][:4]:
        info = play(env, scene, witness)
        assert info["is_success"], (scene.seed, info)


def test_obstacles_stand_on_the_stroke(drawn, env):
    """The demonstrated way, carried to the episode's stroke, runs into them."""
    demonstrations = Demonstrations.load("DrawS")
    pen, posture = pen_path(demonstrations.configurations[0]), demonstrations.configurations[0]
    for scene, witness in drawn["easy"][:5]:
        points = np.array(scene.goals[0].checkpoints)
        line = np.stack(
            [
                np.interp(np.linspace(0, 1, 200), np.linspace(0, 1, len(points)), c)
                for c in points.T
            ],
            axis=-1,
        )
        way, error = follow(line, np.resize(posture, witness.shape), iterations=30)
        assert error < 1e-3
        assert len(pen) == len(way)
        start = scene.model_copy(update={"start": tuple(way[0].tolist())})
        assert play(env, start, way)["collided"]


def test_sampling_is_a_pure_function():
    first = sample_scene("DrawS", "hard", 4)
    sample_scene("DrawS", "easy", 5)
    assert sample_scene("DrawS", "hard", 4) == first
    assert sample_scene("DrawS", "hard", 5) != first


def place(difficulty, seed):
    return place_without_witness("DrawS", difficulty, seed)


def depths(way, scene):
    """Return how deep obstacles reach into the spheres of arm and pen along a way (T, 6), (T,)."""
    spheres = drawing_body().spheres
    centers = kinematics.sphere_centers(way, spheres)
    least = np.full(len(way), np.inf)
    for obstacle in scene.obstacles:
        turn = Rotation.from_quat(obstacle.quaternion)
        local = np.abs((centers - obstacle.position) @ turn.as_matrix())
        size = np.array(obstacle.size)
        if obstacle.shape != "box":
            flat = np.linalg.norm(local[..., : 2 if obstacle.shape == "cylinder" else 3], axis=-1)
            rest = local[..., 2] * (obstacle.shape == "cylinder")
            local, size = np.stack([flat, rest], axis=-1), size[[0, 2]]
        beyond = local - size
        outside = np.linalg.norm(np.maximum(beyond, 0.0), axis=-1)
        distance = outside + np.minimum(beyond.max(axis=-1), 0.0) - spheres.radius
        least = np.minimum(least, distance.min(axis=1))
    return -least


@pytest.mark.parametrize("difficulty", CROWDED)
def test_scenes_without_a_witness_block_the_stroke_and_leave_its_ends(difficulty, env):
    posture = Demonstrations.load("DrawS").mean
    for seed in range(4):
        scene = place(difficulty, seed)
        assert (scene.difficulty, scene.seed) == (difficulty, None)
        assert len(scene.obstacles) == SPECIFICATIONS[difficulty].obstacles
        points = np.array(scene.goals[0].checkpoints)
        hidden = covered(points, scene.obstacles)
        np.testing.assert_array_equal(hidden, ~np.array(scene.goals[0].demanded))
        assert not hidden[[0, -1]].any()
        assert hidden.mean() <= 0.6
        way, error = follow(points, np.resize(posture[::6], (STROKE_POINTS, 6)), iterations=30)
        assert error < 1e-3
        assert depths(way, scene).max() > 0.015
        assert depths(np.array([scene.start]), scene)[0] < -0.049
        env.reset(options={"scene": scene})


def test_placing_without_a_witness_is_a_pure_function():
    first = place("medium", 4)
    assert place("medium", 4) == first
    assert place("medium", 5) != first


def test_the_tip_of_a_way_is_that_of_kinematics():
    stroke = sample_stroke(np.random.default_rng(0))
    np.testing.assert_allclose(
        tip_path(stroke.trajectory)[:, 0], pen_path(stroke.trajectory), atol=1e-12
    )
    # From where the movement has joined the stroke on, the pen is on it.
    np.testing.assert_allclose(pen_path(stroke.trajectory)[32:], stroke.line[32:], atol=1e-4)
