"""The physics world, checked against mechanics and geometry."""

import os
import sys

import numpy as np
import pytest

from smp_gym.physics.world import GRAVITY, PHYSICS_PERIOD, BulletWorld, Camera
from smp_gym.scene import MAX_OBSTACLES, TABLE, Obstacle

GREY = (0.5, 0.5, 0.5, 1.0)
RED = (1.0, 0.0, 0.0, 1.0)
ORIGIN = (0.0, 0.0, 0.0)


def box(*size, position=ORIGIN):
    return Obstacle(shape="box", position=position, size=size)


def arrange(world, obstacles):
    world.set_obstacles(obstacles)
    for name, obstacle in zip(world.obstacles, obstacles, strict=True):
        world.place(name, obstacle.position, obstacle.quaternion)


@pytest.fixture
def world():
    world = BulletWorld()
    yield world
    world.close()


def test_a_free_body_falls_as_galileo_says(world):
    world.add_body("ball", [box(0.1, 0.1, 0.1)], color=GREY, mass=2.0, position=(0.0, 0.0, 5.0))
    steps = 120
    for _ in range(steps):
        world.step()
    t = steps * PHYSICS_PERIOD
    assert world.velocity("ball")[0][2] == pytest.approx(-GRAVITY * t, rel=1e-6)
    # A semi-implicit step overshoots by one part in the number of steps.
    assert 5.0 - world.pose("ball")[0][2] == pytest.approx(GRAVITY * t**2 / 2, rel=1.1 / steps)


def test_no_gravity_no_motion(world):
    world.set_gravity(False)
    world.add_body("ball", [box(0.1, 0.1, 0.1)], color=GREY, mass=1.0, position=(0.0, 0.0, 5.0))
    for _ in range(20):
        world.step()
    np.testing.assert_array_equal(world.pose("ball")[0], (0.0, 0.0, 5.0))


def test_a_resting_body_touches_what_it_rests_on_and_nothing_near(world):
    world.add_body("table", [TABLE], color=GREY)
    world.add_body("block", [box(0.1, 0.1, 0.1)], color=GREY, mass=1.0, position=(0, 0, 0.1005))
    world.add_body("wall", [box(0.1, 0.1, 0.1)], color=GREY, position=(0.205, 0.0, 0.1))
    for _ in range(120):
        world.step()
    assert world.contacts() == {("block", "table")}


def test_a_contact_is_where_bodies_touch(world):
    world.add_body("floor", [box(1.0, 1.0, 0.1, position=(0.0, 0.0, -0.1))], color=GREY)
    ball = Obstacle(shape="sphere", position=ORIGIN, size=(0.1, 0.1, 0.1))
    world.add_body("ball", [ball], color=GREY, mass=1.0, position=(0.3, -0.2, 0.098))
    world.detect_contacts()
    (contact,) = world.contacts()
    # The ball reaches 2 mm into the floor, right below its centre.
    np.testing.assert_allclose(world.contact_point(contact), (0.3, -0.2, -0.001), atol=1.1e-3)
    assert world.contact_point(("ball", "wall")) is None


def test_an_overlap_is_a_contact_without_any_step(world):
    world.add_body("a", [box(0.1, 0.1, 0.1)], color=GREY, mass=1.0)
    world.add_body("b", [box(0.1, 0.1, 0.1)], color=GREY, position=(0.19, 0.0, 0.0))
    world.detect_contacts()
    assert world.contacts() == {("a", "b")}
    world.place("b", (0.21, 0.0, 0.0))
    world.detect_contacts()
    assert world.contacts() == set()


@pytest.mark.parametrize(
    ("obstacle", "distance"),
    [
        (Obstacle(shape="sphere", position=(0.3, 0.4, 0.0), size=(0.1, 0.1, 0.1)), 0.3),
        (Obstacle(shape="box", position=(0.5, 0.0, 0.0), size=(0.1, 0.2, 0.3)), 0.3),
        (
            Obstacle(
                shape="box",
                position=(0.5, 0.0, 0.0),
                size=(0.1, 0.1, 0.1),
                quaternion=(0.0, 0.0, np.sin(np.pi / 8), np.cos(np.pi / 8)),
            ),
            0.4 - 0.1 * np.sqrt(2),
        ),
        (Obstacle(shape="cylinder", position=(0.0, 0.5, 0.0), size=(0.2, 0.2, 0.3)), 0.2),
        (Obstacle(shape="cylinder", position=(0.0, 0.0, 0.5), size=(0.2, 0.2, 0.3)), 0.1),
    ],
)
def test_clearance_of_each_shape_is_geometry(world, obstacle, distance):
    ball = Obstacle(shape="sphere", position=ORIGIN, size=(0.1,) * 3)
    world.add_body("ball", [ball], color=GREY)
    world.reserve_obstacles()
    arrange(world, [obstacle])
    measured = world.clearance(["ball"], world.obstacles, 1.0)
    # Bullet rounds box and cylinder edges by a margin of less than a millimetre.
    assert measured == pytest.approx(distance, abs=1e-3)
    assert world.clearance(["ball"], world.obstacles, 0.05) == 0.05


def test_parts_of_a_compound_body_are_where_they_should_be(world):
    """A ball falls through the hole of a frame and stops on its bars."""
    bars = [box(0.1, 0.3, 0.05, position=(x, 0.0, 0.0)) for x in (-0.2, 0.2)]
    bars += [box(0.1, 0.1, 0.05, position=(0.0, y, 0.0)) for y in (-0.2, 0.2)]
    world.add_body("frame", bars, color=GREY, position=(1.0, 2.0, 3.0))
    for name, x in (("through", 1.0), ("caught", 1.2)):
        ball = Obstacle(shape="sphere", position=ORIGIN, size=(0.05,) * 3)
        world.add_body(name, [ball], color=RED, mass=0.1, position=(x, 2.0, 3.2))
    for _ in range(120):
        world.step()
    assert world.pose("through")[0][2] < 2.5
    assert world.pose("caught")[0][2] == pytest.approx(3.1, abs=2e-3)


def test_a_single_part_keeps_its_pose_in_the_body(world):
    world.add_body("probe", [box(0.01, 0.01, 0.01)], color=RED, position=(0.0, 0.0, 0.3))
    sideways = (np.sin(np.pi / 4), 0.0, 0.0, np.cos(np.pi / 4))
    pole = Obstacle(shape="cylinder", position=ORIGIN, size=(0.02, 0.02, 0.2), quaternion=sideways)
    world.add_body("pole", [pole], color=GREY)
    assert world.clearance(["probe"], ["pole"], 1.0) == pytest.approx(0.27, abs=1e-3)
    shifted = box(0.01, 0.01, 0.01, position=(0.0, 0.0, 0.2))
    world.add_body("shifted", [shifted], color=GREY)
    assert world.clearance(["probe"], ["shifted"], 1.0) == pytest.approx(0.08, abs=1e-3)


def test_obstacles_can_be_exchanged_and_are_where_they_should_be(world):
    world.add_body("probe", [box(0.01, 0.01, 0.01)], color=RED)
    world.reserve_obstacles()
    for count in (0, 3, 1, MAX_OBSTACLES, 2):
        obstacles = [box(0.02, 0.02, 0.02, position=(0.1 * i, 1.0, 0.0)) for i in range(count)]
        arrange(world, obstacles)
        assert world.obstacles == tuple(f"obstacle_{i}" for i in range(count))
        for i in range(MAX_OBSTACLES):
            world.place("probe", (0.1 * i, 1.0, 0.035))
            distance = world.clearance(["probe"], world.obstacles, 0.02)
            assert distance == pytest.approx(0.005 if i < count else 0.02, abs=1e-4)


def _pile(world):
    world.clear()
    world.add_body("table", [TABLE], color=GREY)
    for i in range(3):
        world.add_body(
            f"block_{i}",
            [box(0.03, 0.03, 0.03)],
            color=GREY,
            mass=0.1,
            position=(0.01 * i, 0.013 * i, 0.05 + 0.065 * i),
        )
    world.reserve_obstacles()
    for _ in range(20):
        world.step()
    return world.snapshot()


def _fall(world, obstacles):
    arrange(world, obstacles)
    states = []
    for _ in range(150):
        world.step()
        for i in range(3):
            states += [*world.pose(f"block_{i}"), *world.velocity(f"block_{i}")]
    return np.concatenate(states)


def test_restoring_repeats_bit_for_bit_whatever_was_played_before(world):
    def posts(*heights):
        return [
            box(0.02, 0.02, h, position=(0.06 * np.cos(i), 0.06 * np.sin(i), h))
            for i, h in enumerate(heights)
        ]

    snapshot = _pile(world)
    first = _fall(world, posts(0.05, 0.1, 0.02))
    for others in (posts(), posts(0.2), posts(*[0.03] * 9)):
        world.restore(snapshot)
        _fall(world, others)
        world.restore(snapshot)
        np.testing.assert_array_equal(_fall(world, posts(0.05, 0.1, 0.02)), first)
    world.restore(_pile(world))
    np.testing.assert_array_equal(_fall(world, posts(0.05, 0.1, 0.02)), first)
    assert np.isfinite(first).all()


def test_worlds_do_not_meet(world):
    other = BulletWorld()
    other.add_body("a", [box(0.1, 0.1, 0.1)], color=GREY)
    world.add_body("b", [box(0.1, 0.1, 0.1)], color=GREY, mass=1.0)
    world.detect_contacts()
    assert world.contacts() == set()
    other.close()
    world.step()


def test_a_picture_shows_the_body_where_the_camera_looks(world):
    world.add_body("cube", [box(0.1, 0.1, 0.1)], color=RED, position=(1.0, 0.0, 0.0))
    picture = world.picture(Camera(target=(1.0, 0.0, 0.0), distance=1.0), 64, 48)
    assert picture.shape == (48, 64, 3)
    assert picture.dtype == np.uint8
    red = (picture[..., 0] > 1.5 * picture[..., 1]) & (picture[..., 0] > 60)
    assert red[24, 32]
    assert not red[:4].any()
    away = world.picture(Camera(target=(-3.0, 0.0, 0.0), distance=1.0), 64, 48)
    assert not ((away[..., 0] > 1.5 * away[..., 1]) & (away[..., 0] > 60)).any()


def test_obstacles_stop_a_block_alike_whether_seen_or_not():
    shapes = [
        box(0.1, 0.1, 0.1, position=(0.0, 0.0, 0.1)),
        Obstacle(shape="cylinder", position=(1.0, 0.0, 0.1), size=(0.1, 0.1, 0.1)),
        Obstacle(shape="sphere", position=(2.0, 0.0, 0.1), size=(0.1, 0.1, 0.1)),
    ]
    fallen = []
    for seen in (True, False):
        world = BulletWorld(seen=seen)
        world.reserve_obstacles()
        arrange(world, shapes)
        for x in range(3):
            at = (x + 0.01, 0.0, 0.26)
            world.add_body(f"block{x}", [box(0.05, 0.05, 0.05)], color=GREY, mass=1.0, position=at)
        for _ in range(60):
            world.step()
        assert world.contacts() == {(f"block{x}", f"obstacle_{x}") for x in range(3)}
        fallen.append(np.concatenate([np.hstack(world.pose(f"block{x}")) for x in range(3)]))
        world.close()
    np.testing.assert_array_equal(*fallen)


def test_closing_twice_is_harmless():
    world = BulletWorld()
    assert not world.closed
    world.close()
    world.close()
    assert world.closed


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="X servers are Linux's")
def test_a_window_without_display_is_a_clear_error(monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    assert "DISPLAY" not in os.environ
    with pytest.raises(RuntimeError, match="rgb_array"):
        BulletWorld(gui=True)
