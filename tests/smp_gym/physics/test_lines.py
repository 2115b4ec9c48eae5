"""Lines in pictures and in the window."""

import itertools

import numpy as np
import pybullet
import pytest

from smp_gym.env import ManipulationEnv
from smp_gym.physics.lines import Line, wire_box
from smp_gym.physics.world import BulletWorld, Camera
from smp_gym.scene import Obstacle

BLUE = (0.0, 0.0, 1.0)
GREY = (0.5, 0.5, 0.5, 1.0)


@pytest.fixture
def world():
    made = BulletWorld()
    yield made
    made.close()


def test_a_wire_box_passes_all_edges_and_nothing_else():
    position, size = np.array([0.4, -0.1, 0.3]), np.array([0.1, 0.2, 0.3])
    corners = np.rint((wire_box(position, size) - position) / size).astype(int)
    assert (np.abs(corners) == 1).all()
    passed = {frozenset(map(tuple, pair)) for pair in itertools.pairwise(corners)}
    everywhere = list(itertools.product((-1, 1), repeat=3))
    edges = {
        frozenset((a, b))
        for a, b in itertools.combinations(everywhere, 2)
        if sum(u != v for u, v in zip(a, b, strict=True)) == 1
    }
    assert passed == edges


def blue(image):
    red, green, blue = (image[..., i].astype(int) for i in range(3))
    return (blue > red + 80) & (blue > green + 80)


def test_lines_are_drawn_where_no_body_hides_them(world):
    wall = Obstacle(shape="box", position=(0.0, 0.0, 0.0), size=(0.05, 0.3, 0.3))
    world.add_body("wall", [wall], color=GREY)
    camera = Camera(distance=1.0, yaw=90.0, pitch=0.0)
    for x, seen in ((0.2, True), (-0.2, False)):
        line = Line(np.array([[x, -0.1, 0.0], [x, 0.1, 0.0]]), BLUE, 0.02)
        shown = blue(world.picture(camera, 120, 100, (line,)))
        assert shown[50, 60] == seen
        assert not shown[:40].any()
        assert not shown[60:].any()
        unhidden = Line(line.points, BLUE, 0.02, hidden=False)
        assert blue(world.picture(camera, 120, 100, (unhidden,)))[50, 60]
    assert not blue(world.picture(camera, 120, 100, (Line(np.zeros((1, 3)), BLUE, 0.02),))).any()


def test_the_window_gets_each_piece_of_a_growing_line_once(world, monkeypatch):
    drawn, cleared = [], []
    monkeypatch.setattr(
        pybullet, "addUserDebugLine", lambda a, b, **_: drawn.append((tuple(a), tuple(b)))
    )
    monkeypatch.setattr(pybullet, "removeAllUserDebugItems", lambda **_: cleared.append(1))
    points = np.arange(12.0).reshape(4, 3)
    pieces = [tuple(map(tuple, pair)) for pair in itertools.pairwise(points.tolist())]
    for count in (1, 2, 4, 4):
        world.show_lines((Line(points[:count], BLUE, 0.01),))
    assert drawn == pieces
    assert not cleared
    world.show_lines(())
    world.show_lines((Line(points, BLUE, 0.01),))
    assert drawn == 2 * pieces
    assert len(cleared) == 1


def test_pictures_of_push_lift_box_show_where_the_box_shall_be():
    env = ManipulationEnv("PushLiftBox", "none", render_mode="rgb_array", width=240, height=180)
    for seed in (0, 1):
        env.reset(seed=seed)
        red, green, blue = (env.render()[..., i].astype(int) for i in range(3))
        wire = np.argwhere((green > red + 60) & (green > blue + 40))
        env._cell.world.place("object", env.scene.goals[0].position)
        red, green, blue = (env.render()[..., i].astype(int) for i in range(3))
        yellow = np.argwhere((red > 100) & (green > 70) & (2 * blue < green))
        assert len(wire) > 20
        assert np.abs(wire.min(axis=0) - yellow.min(axis=0)).max() <= 2
        assert np.abs(wire.max(axis=0) - yellow.max(axis=0)).max() <= 2
    env.close()
