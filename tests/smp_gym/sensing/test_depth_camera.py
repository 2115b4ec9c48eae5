"""The depth camera against the exact distance to the bodies that it looks at."""

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces

import smp_gym  # noqa: F401
from smp_gym.geometry.distance import signed_distance
from smp_gym.observation import CLOUD_POINTS, decode, observation_space
from smp_gym.sampling import sample_scene
from smp_gym.scene import Obstacle
from smp_gym.sensing.depth_camera import (
    CAMERA_POSITION,
    LOST_SHARE,
    DepthSensor,
    depth_deviation,
)

PLACEMENT = "smp_gym/Placement-v0"
STAY = np.zeros(7, np.float32)


@pytest.fixture(scope="module")
def env():
    env = gymnasium.make(PLACEMENT, difficulty="hard", sensing="depth").unwrapped
    yield env
    env.close()


def scene_of_cubes():
    """Return a scene of which the camera has less than `CLOUD_POINTS` points, but many."""
    cubes = tuple(
        Obstacle(shape="box", position=(0.4, y, z), size=(0.06, 0.06, 0.06))
        for y, z in ((-0.3, 0.1), (0.1, 0.6))
    )
    return sample_scene("Placement", "none", 0).model_copy(update={"obstacles": cubes})


def traced(origin, rays, obstacles):
    """Return how far (N,) rays of length 1 go, by sphere tracing on the exact distance."""
    along = np.zeros(len(rays))
    for _ in range(200):
        along += signed_distance(origin + along[:, None] * rays, obstacles)
        along = np.minimum(along, 3.0)
    return along


def test_points_lie_on_the_surfaces_within_the_noise_of_their_distance(env):
    errors = []
    for seed in range(6):
        observation, _ = env.reset(seed=seed)
        points = decode(observation, "Placement").points
        origin = env._sensor.camera.position
        assert np.abs(origin - CAMERA_POSITION).max() <= 0.02
        measured = np.linalg.norm(points - origin, axis=1)
        rays = (points - origin) / measured[:, None]
        true = traced(origin, rays, env.scene.obstacles)
        # Past an edge, float32 may miss what the camera met.
        met = true < 2.5
        assert met.mean() > 0.98
        errors.append(((measured - true) / depth_deviation(true))[met])
    errors = np.concatenate(errors)
    errors = errors[np.abs(errors) < 6.0]
    assert len(errors) > 2000
    assert abs(errors.std() - 1.0) < 0.1
    # The engine's rays may end some tenths of a millimetre before the surface.
    assert abs(errors.mean()) < 0.2


def test_noise_grows_with_the_square_of_the_distance():
    # Khoshelham & Elberink 2012: some millimetres nearby, about 4 cm at 5 m.
    near, far = depth_deviation(np.array([1.0, 5.0]))
    assert 0.001 < near < 0.003
    assert 0.03 < far < 0.04
    assert far == pytest.approx(25.0 * near)


def test_a_share_of_what_is_seen_is_lost_in_patches(env):
    env.reset(options={"scene": scene_of_cubes()})
    sensor, world = env._sensor, env._cell.world
    rays = sensor._rays
    names, _ = world.cast_rays(sensor.camera.position.tolist(), sensor.camera.position + 2.5 * rays)
    seen = np.array([name.startswith("obstacle_") for name in names])
    points = sensor.perceive(env.scene.obstacles, world, 0)
    assert 200 < len(points) < CLOUD_POINTS
    assert len(points) == seen.sum() - round(LOST_SHARE * seen.sum())
    directions = (points - sensor.camera.position) / np.linalg.norm(
        points - sensor.camera.position, axis=1, keepdims=True
    )
    cosines = directions @ rays.T
    kept = np.zeros(len(rays), np.bool_)
    kept[cosines.argmax(axis=1)] = True
    lost = (seen & ~kept).reshape(96, 128)
    # Were points lost one by one, a lost one's neighbour would be lost as often as any.
    beside = seen.reshape(96, 128)[:, 1:] & lost[:, :-1]
    assert lost[:, 1:][beside].mean() > 1.5 * LOST_SHARE


def test_no_point_is_of_the_table_the_arm_the_goal_or_the_object(env):
    observation, _ = env.reset(options={"scene": sample_scene("Placement", "none", 0)})
    assert not observation["points"].any()
    decoded = decode(observation, "Placement")
    assert decoded.points.shape == (0, 3)
    assert decoded.scene.obstacles == ()


def test_the_arm_hides_what_is_behind_it(env):
    scene = sample_scene("Placement", "none", 0)
    origin = np.array(CAMERA_POSITION)
    base = np.array([0.0, 0.0, 0.4])
    behind = base + 0.35 * (base - origin) / np.linalg.norm(base - origin)
    post = Obstacle(shape="box", position=tuple(behind.tolist()), size=(0.02, 0.02, 0.1))
    env.reset(options={"scene": scene.model_copy(update={"obstacles": (post,)})})
    camera, rays = env._sensor.camera, env._sensor._rays
    names, _ = env._cell.world.cast_rays(camera.position.tolist(), camera.position + 2.5 * rays)
    alone = (traced(camera.position, rays, (post,)) < 2.5).sum()
    assert sum(name == "obstacle_0" for name in names) < alone


def test_the_cloud_is_a_function_of_the_scene_and_stays_while_nothing_moves(env):
    first, _ = env.reset(seed=7)
    for _ in range(5):
        later = env.step(STAY)[0]
    np.testing.assert_array_equal(later["points"], first["points"])
    env.reset(seed=8)
    again, _ = env.reset(options={"scene": sample_scene("Placement", "hard", 7)})
    np.testing.assert_array_equal(again["points"], first["points"])


def test_flattened_observations_are_recognised(env):
    observation, _ = env.reset(seed=7)
    space = observation_space("Placement", "depth")
    assert space.contains(observation)
    flat = decode(spaces.flatten(space, observation), "Placement")
    np.testing.assert_array_equal(flat.points, decode(observation, "Placement").points)
    assert flat.scene.goals == decode(observation, "Placement").scene.goals


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda points: 0.01 * points, "normalised"),
        (lambda points: points - points.mean(), "normalised"),
        (lambda points: np.roll(points, 3 * CLOUD_POINTS // 2), "before those that are not"),
        (lambda points: points[:-3], "shape"),
    ],
)
def test_what_is_no_cloud_is_refused(env, change, message):
    observation, _ = env.reset(options={"scene": scene_of_cubes()})
    with pytest.raises(ValueError, match=message):
        decode({**observation, "points": change(observation["points"])}, "Placement")


def test_a_camera_inside_a_body_is_refused_and_the_episode_goes_on(env):
    before, _ = env.reset(seed=7)
    around = Obstacle(shape="sphere", position=CAMERA_POSITION, size=(0.1, 0.1, 0.1))
    bad = env.scene.model_copy(update={"obstacles": (around,)})
    with pytest.raises(ValueError, match=r"camera at .* outside of all bodies, got obstacles\[0\]"):
        env.reset(options={"scene": bad})
    np.testing.assert_array_equal(env.step(STAY)[0]["points"], before["points"])
    again, _ = env.reset(seed=7)
    np.testing.assert_array_equal(again["points"], before["points"])


def test_moving_obstacles_are_seen_where_they_are(env):
    env.reset(options={"scene": scene_of_cubes()})
    sensor, world = env._sensor, env._cell.world
    here = sensor.perceive(env.scene.obstacles, world, 0)
    shift = np.array([0.0, 0.05, 0.05])
    moved = tuple(
        o.model_copy(update={"position": tuple((o.position + shift).tolist())})
        for o in env.scene.obstacles
    )
    for name, obstacle in zip(world.obstacles, moved, strict=True):
        world.place(name, obstacle.position, obstacle.quaternion)
    world.detect_contacts()
    there = sensor.perceive(moved, world, 4)
    assert np.abs(signed_distance(there, moved)).max() < 0.015
    assert np.abs(signed_distance(here, moved)).max() > 0.03
    assert isinstance(sensor, DepthSensor)
