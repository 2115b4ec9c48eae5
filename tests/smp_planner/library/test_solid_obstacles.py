"""Capsules, cones and height maps as obstacles, against PyBullet and trimesh."""

import numpy as np
import pybullet
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from smp_gym.geometry.distance import signed_distance
from smp_planner import SMP, capsule_obstacles, cone_obstacles, height_map_obstacles

POSES = [
    ((0.0, 0.0, 0.0), Rotation.identity()),
    *(
        (tuple(shift), turn)
        for shift, turn in zip(
            np.random.default_rng(0).normal(0.0, 0.5, (3, 3)),
            Rotation.random(3, random_state=0),
            strict=True,
        )
    ),
]
"""Positions (3,) m and turns."""


@pytest.fixture
def bullet():
    client = pybullet.connect(pybullet.DIRECT)
    yield client
    pybullet.disconnect(client)


def distances(client, body, points, reach=5.0):
    """Return distances (N,) m of points to a body, by PyBullet, from a ball of 1 mm."""
    ball = pybullet.createMultiBody(
        0,
        pybullet.createCollisionShape(pybullet.GEOM_SPHERE, radius=1e-3, physicsClientId=client),
        physicsClientId=client,
    )
    found = []
    for point in points:
        pybullet.resetBasePositionAndOrientation(
            ball, point, (0.0, 0.0, 0.0, 1.0), physicsClientId=client
        )
        near = pybullet.getClosestPoints(ball, body, reach, physicsClientId=client)
        found.append(min(contact[8] for contact in near) + 1e-3)
    pybullet.removeBody(ball, physicsClientId=client)
    return np.array(found)


@pytest.mark.parametrize(("position", "turn"), POSES)
@pytest.mark.parametrize(("radius", "length"), [(0.1, 0.5), (0.3, 0.05), (0.02, 1.0), (0.2, 0.0)])
def test_a_capsule_is_exact(bullet, radius, length, position, turn):
    obstacles = capsule_obstacles(radius, length, position=position, quaternion=turn.as_quat())
    shape = (
        {"shapeType": pybullet.GEOM_CAPSULE, "radius": radius, "height": length}
        if length
        else {"shapeType": pybullet.GEOM_SPHERE, "radius": radius}
    )
    body = pybullet.createMultiBody(
        0,
        pybullet.createCollisionShape(**shape, physicsClientId=bullet),
        basePosition=position,
        baseOrientation=turn.as_quat(),
        physicsClientId=bullet,
    )
    local = np.random.default_rng(1).uniform(-1.0, 1.0, (300, 3)) * (radius + length / 2 + 0.1)
    points = turn.apply(local) + position
    # The distance to a capsule is that to its axis, less the radius.
    along = np.clip(local[:, 2], -length / 2, length / 2)
    exact = np.linalg.norm(local - np.outer(along, (0.0, 0.0, 1.0)), axis=1) - radius
    distance = signed_distance(points, obstacles)
    outside = exact > 2e-3
    assert outside.sum() > 50
    assert (~outside).any()
    np.testing.assert_allclose(distance[outside], exact[outside], atol=1e-9)
    np.testing.assert_allclose(
        distance[outside], distances(bullet, body, points[outside]), atol=2e-4
    )
    inside = exact < 0.0
    assert (distance[inside] <= exact[inside] / 2 + 1e-9).all()
    assert (distance[inside] >= exact[inside] - 1e-9).all()


@pytest.mark.parametrize(("position", "turn"), POSES)
@pytest.mark.parametrize(
    ("radius", "height", "overshoot"),
    [(0.1, 0.3, 0.005), (0.3, 0.1, 0.01), (0.2, 0.2, 0.05), (0.05, 1.0, 0.002), (0.1, 0.3, 1.0)],
)
def test_a_cone_is_held_and_no_more_than_said(radius, height, overshoot, position, turn):
    obstacles = cone_obstacles(
        radius, height, overshoot=overshoot, position=position, quaternion=turn.as_quat()
    )
    mesh = trimesh.creation.cone(radius, height, sections=256)
    mesh.apply_translation((0.0, 0.0, -height / 2))
    rng = np.random.default_rng(2)
    on = np.asarray(trimesh.sample.sample_surface(mesh, 1500, seed=0)[0])
    on = np.concatenate([on, np.asarray(mesh.vertices)])
    assert signed_distance(turn.apply(on) + position, obstacles).max() <= 1e-9
    # No point of the cylinders, not even of their edges, lies further off than the overshoot.
    parts = []
    for obstacle in obstacles:
        angle = rng.uniform(0.0, 2.0 * np.pi, 40)
        local = np.column_stack(
            [np.cos(angle), np.sin(angle), np.sign(rng.uniform(-1.0, 1.0, 40))]
        ) * np.array(obstacle.size)
        parts.append(Rotation.from_quat(obstacle.quaternion).apply(local) + obstacle.position)
    edges = turn.inv().apply(np.concatenate(parts) - position)
    _, off, _ = trimesh.proximity.closest_point_naive(mesh, edges)
    flank = radius * (1.0 - np.pi**2 / 256**2 / 2) * (0.5 - edges[:, 2] / height)
    beyond = np.hypot(edges[:, 0], edges[:, 1]) > flank
    assert np.where(beyond, off, 0.0).max() <= overshoot + 1e-4 * radius
    # Depths inside, where that of a cone is the least of those below flank and above base.
    local = rng.uniform(-1.0, 1.0, (2000, 3)) * (radius, radius, height / 2)
    slope = np.hypot(radius, height)
    flank = (
        height * np.hypot(local[:, 0], local[:, 1]) + radius * (local[:, 2] - height / 2)
    ) / slope
    exact = np.maximum(flank, -local[:, 2] - height / 2)
    inside = exact < 0.0
    assert inside.sum() > 100
    distance = signed_distance(turn.apply(local[inside]) + position, obstacles)
    assert (distance <= 0.7 * exact[inside]).all()


def maps():
    """Return height maps (N, M) m and the floors below them."""
    rng = np.random.default_rng(3)
    stairs = np.repeat(np.linspace(0.0, 0.3, 4), 3)[:, None] + np.zeros(7)
    noise = rng.uniform(0.0, 0.3, (6, 9))
    pits = np.full((8, 8), 0.2)
    pits[2:4, 2:6] = pits[6, 1] = 0.0
    tower = np.zeros((5, 7))
    tower[2, 3] = 0.5
    bumps = np.zeros((9, 9))
    bumps[::4, ::4] = 0.03
    return {
        "stairs": (stairs, -0.1),
        "noise": (noise, -0.2),
        "pits": (pits, 0.0),
        "tower": (tower, 0.0),
        "bumps": (bumps, 0.0),
        "cell": (np.full((1, 1), 0.1), 0.0),
    }


@pytest.mark.parametrize("overshoot", [0.0, 0.04])
@pytest.mark.parametrize("name", maps())
def test_a_height_map_is_held_and_no_more_than_said(bullet, name, overshoot):
    heights, floor = maps()[name]
    side = 0.1
    for position, turn in POSES[:2]:
        obstacles = height_map_obstacles(
            heights, side, floor=floor, overshoot=overshoot, position=position,
            quaternion=turn.as_quat(),
        )  # fmt: skip
        assert len(obstacles) <= (heights > floor).sum()
        cells = np.argwhere(heights > floor)
        tops = heights[heights > floor]
        halves = np.column_stack([np.full((len(cells), 2), side / 2), (tops - floor) / 2])
        centers = np.column_stack([(cells + 0.5) * side, (tops + floor) / 2])
        reach = np.array([*heights.shape, 1.0]) * (side, side, heights.max() - floor)
        local = np.random.default_rng(4).uniform(-0.2, 1.2, (400, 3)) * reach + (0.0, 0.0, floor)
        # Independent: the nearest of all columns, each a box of its own.
        gap = np.abs(local[:, None] - centers) - halves
        exact = np.linalg.norm(np.maximum(gap, 0.0), axis=2).min(axis=1)
        distance = signed_distance(turn.apply(local) + position, obstacles)
        inside = (gap < 0.0).all(axis=2).any(axis=1)
        assert inside.any()
        assert (distance[inside] <= 0.0).all()
        assert (distance[~inside] <= exact[~inside] + 1e-9).all()
        assert (np.maximum(distance, 0.0) >= exact - overshoot - 1e-9).all()
        if overshoot > 0.0:
            continue
        columns = [
            pybullet.createMultiBody(
                0,
                pybullet.createCollisionShape(
                    pybullet.GEOM_BOX, halfExtents=half, physicsClientId=bullet
                ),
                basePosition=turn.apply(center) + position,
                baseOrientation=turn.as_quat(),
                physicsClientId=bullet,
            )
            for center, half in zip(centers, halves, strict=True)
        ]
        far = np.flatnonzero(distance > 0.02)[:40]
        points = (turn.apply(local) + position)[far]
        measured = np.min([distances(bullet, body, points) for body in columns], axis=0)
        np.testing.assert_allclose(distance[far], measured, atol=1e-3)


def test_cells_of_equal_height_make_few_boxes():
    heights, floor = maps()["stairs"]
    assert len(height_map_obstacles(heights, 0.1, floor=floor)) == 4
    flat = height_map_obstacles(np.zeros((40, 30)), 0.1, floor=-0.1)
    assert [box.size for box in flat] == [pytest.approx((2.0, 1.5, 0.05))]
    slope = np.linspace(0.0, 1.0, 101)[:, None] + np.zeros(20)
    assert len(height_map_obstacles(slope, 0.1, floor=-0.1, overshoot=0.1001)) == 10


def test_unknown_cells_are_as_high_as_said():
    heights = np.array([[0.1, np.nan], [0.0, 0.2]])
    with pytest.raises(ValueError, match=r"heights must be finite, got nan at \(0, 1\)"):
        height_map_obstacles(heights, 0.1, floor=0.0)
    known = np.array([[0.1, 0.3], [0.0, 0.2]])
    assert height_map_obstacles(heights, 0.1, floor=0.0, unknown=0.3) == height_map_obstacles(
        known, 0.1, floor=0.0
    )


@pytest.mark.parametrize(
    ("build", "arguments", "named"),
    [
        (capsule_obstacles, {"radius": 0.0}, "radius must be a finite number above"),
        (capsule_obstacles, {"length": -0.1}, "length must be a finite number at least"),
        (capsule_obstacles, {"length": "long"}, "length must be"),
        (capsule_obstacles, {"position": (0.0, 1.0)}, "position must have shape"),
        (capsule_obstacles, {"quaternion": (0.0, 0.0, 0.0, 0.5)}, "quaternion must have norm 1"),
        (cone_obstacles, {"radius": float("inf")}, "radius must be"),
        (cone_obstacles, {"height": 0.0}, "height must be"),
        (cone_obstacles, {"overshoot": 0.0}, "overshoot must be"),
        (cone_obstacles, {"overshoot": 1e-9}, "overshoot must be large enough for 4096 cylinders"),
        (cone_obstacles, {"overshoot": 1e-320}, "overshoot must be large enough for 4096"),
        (height_map_obstacles, {"heights": [1.0, 2.0]}, "heights must have shape"),
        (height_map_obstacles, {"heights": np.zeros((0, 3))}, "heights must have 1 to 250000"),
        (height_map_obstacles, {"heights": np.zeros((600, 600))}, "heights must have 1 to 250000"),
        (height_map_obstacles, {"heights": [[0.1, np.inf]]}, r"heights .* got inf at \(0, 1\)"),
        (height_map_obstacles, {"heights": [[0.1, -0.2]]}, r"floor, 0.0, got -0.2 at \(0, 1\)"),
        (height_map_obstacles, {"resolution": 0.0}, "resolution must be"),
        (height_map_obstacles, {"overshoot": -0.1}, "overshoot must be"),
        (height_map_obstacles, {"unknown": -0.1}, "unknown must be a finite number at least 0.0"),
        (height_map_obstacles, {"floor": None}, "floor must be"),
        (
            height_map_obstacles,
            {"heights": np.random.default_rng(0).uniform(size=(100, 100))},
            "overshoot must be large enough for 4096 boxes",
        ),
    ],
)
def test_bad_arguments_are_named(build, arguments, named):
    good = {
        capsule_obstacles: {"radius": 0.1, "length": 0.2},
        cone_obstacles: {"radius": 0.1, "height": 0.2, "overshoot": 0.01},
        height_map_obstacles: {"heights": [[0.1, 0.2]], "resolution": 0.1, "floor": 0.0},
    }
    with pytest.raises(ValueError, match=named):
        build(**{**good[build], **arguments})


def test_paths_keep_clear_of_them():
    """Over a wall of a height map and past a cone, by the bodies' own formulas."""
    phase = np.linspace(0.0, 1.0, 60)
    paths = [
        np.stack([phase, 0.1 * bend * np.sin(np.pi * phase), 0.2 + 0.0 * phase], axis=1)
        for bend in (-1.0, 0.0, 1.0)
    ]
    wall = np.zeros((20, 20))
    wall[8:10] = 0.25
    obstacles = [
        *height_map_obstacles(wall, 0.05, floor=0.0, position=(0.0, -0.5, 0.0)),
        *cone_obstacles(0.1, 0.6, overshoot=0.01, position=(0.7, 0.0, 0.3)),
    ]
    plan = SMP.fit(paths).adapt(
        obstacles, start=(0.0, 0.0, 0.2), goal=(1.0, 0.0, 0.2), particles=12, seed=0
    )
    assert plan.good.mean() > 0.5
    for path in plan.trajectories[plan.good]:
        over = (path[:, 0] >= 0.4) & (path[:, 0] <= 0.5)
        # Nothing stands below the floor of the map.
        assert ((path[over, 2] > 0.25) | (path[over, 2] < 0.0)).all()
        side = np.hypot(path[:, 0] - 0.7, path[:, 1])
        assert not ((side <= 0.1 * (1.0 - path[:, 2] / 0.6)) & (path[:, 2] >= 0.0)).any()
