"""Rods from which obstacles hang in pictures."""

import numpy as np
import pytest

from smp_gym.physics.hangers import hangers
from smp_gym.physics.world import BulletWorld, Camera
from smp_gym.scene import Obstacle

_BALL = Obstacle(shape="sphere", position=(0.3, 0.0, 0.4), size=(0.05, 0.05, 0.05))
_POST = Obstacle(shape="box", position=(0.5, 0.3, 0.2), size=(0.03, 0.03, 0.2))


def test_what_is_in_the_air_hangs_and_what_stands_or_lies_on_it_does_not():
    board = Obstacle(shape="box", position=(0.5, 0.3, 0.41), size=(0.1, 0.1, 0.01))
    ball, post, lying = hangers([_BALL, _POST, board])
    assert post == lying == []
    (rod,) = ball
    top = _BALL.position[2] + rod.position[2] + rod.size[2]
    bottom = _BALL.position[2] + rod.position[2] - rod.size[2]
    assert bottom == pytest.approx(0.45)
    assert top > 1.0


def test_a_leaning_obstacle_has_none():
    turned = (np.sin(0.3), 0.0, 0.0, np.cos(0.3))
    leaning = Obstacle(
        shape="box", position=(0.3, 0, 0.5), size=(0.02, 0.02, 0.1), quaternion=turned
    )
    assert hangers([leaning]) == [[]]


def test_a_rod_is_seen_and_touches_nothing():
    world = BulletWorld()
    world.reserve_obstacles()
    above = Camera(target=(0.3, 0.0, 0.8), distance=1.0, pitch=0.0)
    empty = world.picture(above, width=60, height=60).astype(float)
    world.set_obstacles([_BALL])
    world.place("obstacle_0", _BALL.position)
    hung = world.picture(above, width=60, height=60).astype(float)
    # The ball is below the middle of the picture, the rod is all that is above it.
    assert np.abs(hung - empty)[:30].max() > 10.0
    met, _ = world.cast_rays((0.0, 0.0, 0.8), np.array([[0.6, 0.0, 0.8]]))
    assert met == ("",)
    met, _ = world.cast_rays((0.0, 0.0, 0.4), np.array([[0.6, 0.0, 0.4]]))
    assert met == ("obstacle_0",)
    world.close()
