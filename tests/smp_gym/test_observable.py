"""Scenes that observations cannot hold, cameras and displays that cannot be used: refused."""

import os
import socket

import gymnasium as gym
import numpy as np
import pytest

import smp_gym  # noqa: F401
from smp_gym.observation import Encoder, check_observable
from smp_gym.physics import display
from smp_gym.physics.world import Camera
from smp_gym.sampling import sample_scene
from smp_gym.scene import Motion, Obstacle
from smp_gym.tasks.registry import task_names

PLACEMENT = "smp_gym/Placement-v0"


@pytest.fixture(scope="module")
def bare():
    return sample_scene("Placement", "none", 0)


@pytest.fixture(scope="module")
def env():
    made = gym.make(PLACEMENT, difficulty="none")
    yield made
    made.close()


def box(position=(0.5, 0.5, 0.5), size=(0.05, 0.05, 0.05), **more):
    return Obstacle(shape="box", position=position, size=size, **more)


def going(*points):
    return box(points[0], motion=Motion(times=tuple(range(len(points))), points=points))


@pytest.mark.parametrize(
    ("body", "field"),
    [
        (box((2.1, 0.0, 0.5)), "position"),
        (box((0.0, -1e9, 0.5)), "position"),
        # A wall at 2 m that reaches to 1.05 m would be seen there; one at 3 m would be, too.
        (box((3.05, 0.0, 0.5), (2.0, 1.0, 1.0)), "position"),
        (box((0.0, 1.5, -3.0), (0.1, 0.1, 2.9)), "position"),
        (box(size=(0.1, 2.5, 0.1)), "size"),
        (box(size=(0.1, 1e-50, 0.1)), "size"),
        (going((1.5, 0.5, 0.5), (1.9, 0.5, 0.5), (2.2, 0.5, 0.5)), "position"),
        # Between its knots only: the curve swings out beyond 2 m.
        (going((1.99, 0.5, 0.5), (0.5, 0.5, 0.5), (1.99, 0.5, 0.5), (1.98, 0.5, 0.5)), "position"),
        (going((0.5, 1.9, 0.5), (0.5, -1.9, 0.5), (0.5, 1.9, 0.5)), "velocity"),
    ],
)
def test_bodies_that_would_be_clipped_are_refused(bare, env, body, field):
    scene = bare.model_copy(update={"obstacles": (box(), body)})
    with pytest.raises(ValueError, match=rf"scene.obstacles\[1\] must have its {field} within"):
        env.reset(options={"scene": scene})
    env.reset(options={"scene": bare})


def test_what_passes_comes_back_within_rounding(bare):
    for body in (box((2.0, -2.0, 1.9), (2.0, 1e-30, 0.5)), box((1e-20, 0.0, 0.3))):
        scene = bare.model_copy(update={"obstacles": (body,)})
        check_observable(scene)
        row = Encoder(scene)._seen["obstacles"][: 4 + 3 + 4 + 3].astype(np.float64)
        np.testing.assert_allclose(row[4:7], body.position, rtol=1e-7)
        np.testing.assert_allclose(row[11:14], body.size, rtol=1e-7)
    large = bare.manipulated.model_copy(update={"size": (1.5, 0.02, 0.02)})
    with pytest.raises(ValueError, match=r"scene\.manipulated must have its object_size"):
        check_observable(bare.model_copy(update={"manipulated": large}))


@pytest.mark.parametrize("task", task_names())
def test_drawn_scenes_are_observable(task):
    check_observable(sample_scene(task, "medium", 3))


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"distance": np.nan}, "camera.distance must be a finite number above 0.0"),
        ({"distance": 0.0}, "camera.distance must be"),
        ({"distance": 1e9}, "camera.distance must be"),
        ({"yaw": np.inf}, "camera.yaw must be a finite number"),
        ({"pitch": "down"}, "camera.pitch must be"),
        ({"pitch": -91.0}, "camera.pitch must be .* at least -90.0"),
        ({"field_of_view": 180.0}, "camera.field_of_view must be"),
        ({"target": (0.0, 0.0)}, "camera.target must have shape"),
        ({"target": (0.0, 0.0, np.nan)}, "camera.target must be finite"),
        ({"zoom": 2}, "camera may hold the entries target"),
        (3, "camera may hold the entries target"),
    ],
)
def test_cameras_are_checked(given, message):
    with pytest.raises(ValueError, match=message):
        gym.make(PLACEMENT, render_mode="rgb_array", camera=given)
    assert Camera(target=np.zeros(3), distance=np.float32(1.5)).target == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("size", [0, -1, 1.5, "480", 10**5, True, None])
@pytest.mark.parametrize("side", ["width", "height"])
def test_sizes_of_pictures_are_checked(side, size):
    with pytest.raises(ValueError, match=rf"{side} must be a whole number from 1 to 4096, got"):
        gym.make(PLACEMENT, render_mode="rgb_array", **{side: size})


def test_a_display_that_is_not_there_is_an_error(monkeypatch, tmp_path):
    for name in (":97", "no.such.host.invalid:0", "nonsense"):
        monkeypatch.setenv("DISPLAY", name)
        with pytest.raises(RuntimeError, match=f"DISPLAY='{name}' cannot be opened"):
            display.check_display()
    with pytest.raises(RuntimeError, match="a window needs a display"):
        gym.make(PLACEMENT, render_mode="human")


def test_a_display_that_does_not_answer_is_an_error(monkeypatch):
    monkeypatch.setattr(display, "_PATIENCE", 1.0)
    with socket.create_server(("127.0.0.1", 0)) as server:
        number = server.getsockname()[1] - 6000
        assert number > 0, os.environ
        monkeypatch.setenv("DISPLAY", f"127.0.0.1:{number}")
        with pytest.raises(RuntimeError, match="does not answer within 1 s"):
            display.check_display()


@pytest.mark.parametrize(
    "action", [np.zeros(7, complex), ["0"] * 7, np.ma.masked_all(7), [None] * 7, [True] * 7]
)
def test_actions_are_real_numbers(env, action):
    env.reset(seed=0)
    with pytest.raises(ValueError, match="action must be"):
        env.unwrapped.step(action)
