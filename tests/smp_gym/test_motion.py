"""Obstacles that move: paths in time, bodies in the physics, rows of the observation, bad input."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pybullet
import pytest
from scipy.interpolate import CubicHermiteSpline

from smp_gym.env import ManipulationEnv
from smp_gym.inspection.checking import make
from smp_gym.observation import CONTROL_PERIOD, decode
from smp_gym.sampling import sample_scene
from smp_gym.scene import Motion, Obstacle, Scene
from smp_gym.tasks.registry import make_task

TIMES = (0.0, 1.0, 1.7, 3.0, 4.0, 6.0)
POINTS = (
    (0.5, 0.1, 0.6),
    (0.5, 0.2, 0.65),
    (0.48, 0.3, 0.6),
    (0.48, 0.3, 0.6),
    (0.45, 0.35, 0.7),
    (0.4, 0.3, 0.7),
)
STILL = np.zeros(7, np.float32)


def _moving(
    points: tuple[Any, ...], times: tuple[float, ...] = TIMES, shape: str = "sphere"
) -> Obstacle:
    motion = Motion(times=times, points=points)
    return Obstacle(shape=shape, position=points[0], size=(0.04,) * 3, motion=motion)


OBSTACLE = _moving(POINTS)


@pytest.fixture(scope="module")
def env() -> Iterator[ManipulationEnv]:
    env = make("smp_gym/Placement-v0", difficulty="none")
    yield env
    env.close()


@pytest.fixture(scope="module")
def free_scene() -> Scene:
    return sample_scene("Placement", "none", 3)


def _crossing(env: ManipulationEnv, scene: Scene, speed: float = 0.1) -> Scene:
    """Return the scene with a box that comes from 0.3 m aside into the hand, which rests."""
    env.reset(options={"scene": scene})
    x, y, z = env._cell.robot.end_effector_position.tolist()
    times = tuple(float(t) for t in range(6))
    box = _moving(tuple((x, y + 0.3 - speed * t, z) for t in times), times, "box")
    return scene.model_copy(update={"obstacles": (box,)})


def _body(env: ManipulationEnv, number: int) -> np.ndarray[Any, Any]:
    """Return the position of an obstacle as the physics engine tells it."""
    world = env._cell.world
    body = world.body(f"obstacle_{number}")
    position, _ = pybullet.getBasePositionAndOrientation(body, physicsClientId=world.client)
    return np.array(position)


def test_motion_passes_its_knots_and_rests_at_the_end() -> None:
    for time, point in zip(TIMES, POINTS, strict=True):
        np.testing.assert_allclose(OBSTACLE.at(time)[0], point, atol=1e-12)
    # Equal points in succession are a rest, from its first moment to its last.
    for time in (1.7, 2.2, 3.0, 6.0, 100.0):
        np.testing.assert_array_equal(OBSTACLE.at(time)[1], np.zeros(3))
    np.testing.assert_allclose(OBSTACLE.at(2.2)[0], POINTS[2], atol=1e-12)
    np.testing.assert_array_equal(OBSTACLE.at(100.0)[0], POINTS[-1])


def test_velocity_is_the_derivative_of_the_position_and_continuous() -> None:
    step = 1e-6
    for time in np.linspace(0.01, 5.99, 50):
        slope = (OBSTACLE.at(time + step)[0] - OBSTACLE.at(time - step)[0]) / (2 * step)
        np.testing.assert_allclose(OBSTACLE.at(time)[1], slope, atol=1e-6)
    for knot in TIMES[1:]:
        before, after = OBSTACLE.at(knot - 1e-9)[1], OBSTACLE.at(knot + 1e-9)[1]
        np.testing.assert_allclose(before, after, atol=1e-6)


def test_motion_agrees_with_an_independent_spline() -> None:
    motion = OBSTACLE.motion
    assert motion is not None
    at_knots = np.array([motion.at(time)[1] for time in TIMES])
    spline = CubicHermiteSpline(TIMES, POINTS, at_knots)
    for time in np.linspace(0.0, 6.0, 61):
        np.testing.assert_allclose(motion.at(time)[0], spline(time), atol=1e-12)


def test_parabola_is_followed_exactly() -> None:
    times = (0.0, 0.5, 1.5, 2.0, 3.0)
    points = tuple((0.1 * t * t, 0.2 * t, 0.5) for t in times)
    motion = Motion(times=times, points=points)
    # All but the last interval, on which the body is brought to rest.
    for time in np.linspace(0.0, 2.0, 9):
        np.testing.assert_allclose(motion.at(time)[0], (0.1 * time**2, 0.2 * time, 0.5))
        np.testing.assert_allclose(motion.at(time)[1], (0.2 * time, 0.2, 0.0), atol=1e-12)


def test_json_gives_the_obstacle_back_and_says_nothing_of_no_motion() -> None:
    assert Obstacle.model_validate_json(OBSTACLE.model_dump_json()) == OBSTACLE
    assert hash(Obstacle.model_validate_json(OBSTACLE.model_dump_json())) == hash(OBSTACLE)
    still = Obstacle(shape="sphere", position=(0.5, 0.0, 0.5), size=(0.04,) * 3)
    assert "motion" not in still.model_dump_json()
    np.testing.assert_array_equal(still.at(3.0)[0], still.position)
    np.testing.assert_array_equal(OBSTACLE.velocity, OBSTACLE.at(0.0)[1])


def test_obstacle_without_motion_goes_on_at_its_velocity() -> None:
    seen = Obstacle(
        shape="sphere", position=(0.5, 0.0, 0.5), size=(0.04,) * 3, velocity=(0.1, 0.0, -0.2)
    )
    np.testing.assert_allclose(seen.at(0.5)[0], (0.55, 0.0, 0.4))
    np.testing.assert_allclose(seen.at(0.5)[1], (0.1, 0.0, -0.2))


@pytest.mark.parametrize(
    ("times", "points", "told"),
    [
        ((0.5, 1.0), POINTS[:2], "begin with 0, got 0.5"),
        ((0.0, 1.0, 1.0), POINTS[:3], "increase, got 1.0 after 1.0"),
        ((0.0, 1.0), POINTS[:3], "as many as its times, 2, got 3"),
        ((0.0, float("nan")), POINTS[:2], "finite"),
        ((0.0, 1.0), (POINTS[0], (0.0, float("inf"), 0.0)), "finite"),
        ((0.0,), POINTS[:1], "at least 2"),
    ],
)
def test_bad_knots_are_told(times: Any, points: Any, told: str) -> None:
    with pytest.raises(ValueError, match=told):
        Motion(times=times, points=points)


def test_motion_must_begin_at_the_obstacle_with_its_velocity() -> None:
    fields = {"shape": "sphere", "size": (0.04,) * 3, "motion": OBSTACLE.motion}
    with pytest.raises(ValueError, match=r"first point of a motion .* got \(0.5, 0.1, 0.6\)"):
        Obstacle(position=(0.5, 0.1, 0.7), **fields)
    with pytest.raises(ValueError, match=r"that at time 0, .* got \(1.0, 0.0, 0.0\)"):
        Obstacle(position=POINTS[0], velocity=(1.0, 0.0, 0.0), **fields)


def test_body_and_observation_are_where_the_path_says(
    env: ManipulationEnv, free_scene: Scene
) -> None:
    scene = free_scene.model_copy(update={"obstacles": (OBSTACLE,)})
    observation, _ = env.reset(options={"scene": scene})
    rng = np.random.default_rng(0)
    for step in range(130):
        position, velocity = OBSTACLE.at(step * CONTROL_PERIOD)
        np.testing.assert_allclose(_body(env, 0), position, atol=1e-9)
        (seen,) = decode(observation, "Placement").scene.obstacles
        np.testing.assert_allclose(seen.position, position, atol=1e-6)
        np.testing.assert_allclose(seen.velocity, velocity, atol=1e-6)
        assert seen.motion is None
        action = np.append(rng.uniform(-0.1, 0.1, 6), 1.0).astype(np.float32)
        observation, _, over, _, _ = env.step(action)
        assert not over


def test_body_that_comes_into_the_resting_hand_is_a_collision(
    env: ManipulationEnv, free_scene: Scene
) -> None:
    scene = _crossing(env, free_scene)
    env.reset(options={"scene": scene})
    for _ in range(60):
        _, reward, over, _, info = env.step(STILL)
        if over:
            break
    assert info["failure"] == "collision"
    assert "obstacle_0" in info["collision"]
    assert reward < 0.0
    # At 10 cm/s and no more than a millimetre deep: it is moved at every physics step.
    assert -0.001 < info["clearance"] < 0.001
    np.testing.assert_allclose(_body(env, 0), scene.obstacles[0].at(env._cell.time)[0], atol=1e-9)


def test_episodes_repeat_and_states_are_exact(env: ManipulationEnv, free_scene: Scene) -> None:
    scene = _crossing(env, free_scene, 0.02).model_copy()
    both = (*scene.obstacles, OBSTACLE)
    scene = scene.model_copy(update={"obstacles": both})
    rng = np.random.default_rng(1)
    actions = np.repeat(rng.uniform(-0.9, 0.9, (4, 7)), 15, axis=0).astype(np.float32)

    def play(begin: int) -> list[bytes]:
        seen = []
        for action in actions[begin:]:
            observation, reward, _, _, info = env.step(action)
            seen += [observation[key].tobytes() for key in sorted(observation)]
            seen.append(np.array([reward, info["clearance"]]).tobytes())
        return seen

    env.reset(options={"scene": scene})
    first = play(0)
    env.reset(options={"scene": free_scene})
    env.step(STILL)
    env.reset(options={"scene": Scene.from_json(scene.to_json())})
    for action in actions[:20]:
        observation, *_ = env.step(action)
    state = env.save_state()
    rest = play(20)
    assert rest == first[-len(rest) :]
    env.reset(options={"scene": free_scene})
    restored, _ = env.restore_state(state)
    for key, vector in observation.items():
        np.testing.assert_array_equal(restored[key], vector)
    assert play(20) == rest


def test_motion_that_begins_in_arm_or_bin_is_refused(
    env: ManipulationEnv, free_scene: Scene
) -> None:
    env.reset(options={"scene": free_scene})
    hand = tuple(env._cell.robot.end_effector_position.tolist())
    aside = (0.5, 0.0, 0.8)
    (bin_goal,) = free_scene.goals
    for place, told in ((hand, "obstacle_0"), (bin_goal.position, "obstacle_0 begins in the bin")):
        inside = _moving((place, aside), (0.0, 5.0))
        with pytest.raises(ValueError, match=told):
            env.reset(options={"scene": free_scene.model_copy(update={"obstacles": (inside,)})})
        env.reset(options={"scene": free_scene})
        env.step(STILL)


def test_velocity_without_motion_is_refused(free_scene: Scene) -> None:
    seen = Obstacle(
        shape="sphere", position=(0.5, 0.0, 0.8), size=(0.04,) * 3, velocity=(0.1, 0.0, 0.0)
    )
    scene = free_scene.model_copy(update={"obstacles": (OBSTACLE, seen)})
    with pytest.raises(ValueError, match=r"scene.obstacles\[1\] without a motion must stand still"):
        make_task("Placement").check_scene(scene)
