"""Obstacles from meshes: they cover them, and paths keep clear of them."""

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from smp_planner import SMP, mesh_obstacles

CELL = 0.05


def in_box(half):
    return lambda points: (np.abs(points) <= half).all(axis=1)


def in_ring(inner, outer, height):
    def inside(points):
        radius = np.hypot(points[:, 0], points[:, 1])
        return (radius >= inner) & (radius <= outer) & (np.abs(points[:, 2]) <= height / 2)

    return inside


def meshes():
    """Return meshes, and whether points (N, 3) are inside of them."""
    top, leg = trimesh.creation.box((0.6, 0.4, 0.03)), trimesh.creation.box((0.05, 0.05, 0.4))
    in_top, in_leg = in_box((0.3, 0.2, 0.015)), in_box((0.025, 0.025, 0.2))
    return {
        "box": (trimesh.creation.box((0.5, 0.3, 0.2)), in_box((0.25, 0.15, 0.1))),
        "pipe": (trimesh.creation.annulus(0.1, 0.2, 0.15), in_ring(0.1, 0.2, 0.15)),
        "ball": (
            trimesh.creation.icosphere(radius=0.25),
            lambda points: np.linalg.norm(points, axis=1) <= 0.25,
        ),
        "table": (
            trimesh.util.concatenate([top, leg]),
            lambda points: in_top(points) | in_leg(points),
        ),
        "plate": (
            trimesh.Trimesh([(0, 0, 0), (0.4, 0, 0), (0, 0.3, 0)], [(0, 1, 2)]),
            lambda points: np.zeros(len(points), bool),
        ),
    }


def depth_beyond(obstacles, points):
    """Return how far points are outside of a union of spheres, m; negative inside."""
    centers = np.array([o.position for o in obstacles])
    radii = np.array([o.size[0] for o in obstacles])
    distance = np.linalg.norm(points[:, None] - centers, axis=2) - radii
    return distance.min(axis=1)


@pytest.mark.parametrize("name", meshes())
def test_a_surface_is_covered_without_a_hole_and_hardly_more(name):
    mesh, inside = meshes()[name]
    obstacles = mesh_obstacles(mesh, cell=CELL)
    on, _ = trimesh.sample.sample_surface(mesh, 4000, seed=0)
    assert depth_beyond(obstacles, np.asarray(on)).max() <= 1e-9
    # Points that lie further off the mesh than a cell's diagonal are free.
    lower, upper = mesh.bounds
    around = np.random.default_rng(0).uniform(lower - 0.3, upper + 0.3, (3000, 3))
    _, distance, _ = trimesh.proximity.closest_point_naive(mesh, around)
    outside = (distance > np.sqrt(3.0) * CELL) & ~inside(around)
    assert outside.any()
    assert depth_beyond(obstacles, around[outside]).min() > 0.0


def test_a_closed_mesh_is_filled():
    mesh, _ = meshes()["box"]
    obstacles = mesh_obstacles(mesh, cell=CELL)
    inside = np.random.default_rng(1).uniform(-1.0, 1.0, (3000, 3)) * (0.23, 0.13, 0.08)
    # But for pockets between the spheres, no wider than a cell.
    assert depth_beyond(obstacles, inside).max() < CELL
    assert (depth_beyond(obstacles, inside) <= 0.0).mean() > 0.9
    # In the middle it is as deep as there is room for a sphere.
    assert depth_beyond(obstacles, np.zeros((1, 3)))[0] < -0.04


def test_a_mesh_is_scaled_turned_and_moved_in_this_order(tmp_path):
    mesh, _ = meshes()["plate"]
    turn = Rotation.from_euler("xyz", (0.3, -0.5, 1.1))
    larger = mesh.copy()
    larger.apply_scale(1000.0)
    larger.export(tmp_path / "plate.stl")
    obstacles = mesh_obstacles(
        tmp_path / "plate.stl", cell=CELL, position=(1, 2, 3), quaternion=turn.as_quat(),
        scale=0.001,
    )  # fmt: skip
    on, _ = trimesh.sample.sample_surface(mesh, 2000, seed=0)
    assert depth_beyond(obstacles, turn.apply(on) + np.array((1, 2, 3))).max() <= 1e-6
    plain = mesh_obstacles(mesh, cell=CELL, position=(1, 2, 3), quaternion=turn.as_quat())
    assert len(plain) == len(obstacles)


def test_paths_keep_clear_of_a_mesh():
    phase = np.linspace(0.0, 1.0, 60)
    paths = [
        np.stack([phase, 0.1 * bend * np.sin(np.pi * phase), 0.2 + 0.1 * phase], axis=1)
        for bend in (-1.0, 0.0, 1.0)
    ]
    ring = trimesh.creation.annulus(0.05, 0.12, 0.1)
    obstacles = mesh_obstacles(ring, cell=0.04, position=(0.5, 0.0, 0.25))
    plan = SMP.fit(paths).adapt(obstacles, particles=12, seed=0)
    assert plan.good.mean() > 0.7
    inside = in_ring(0.05, 0.12, 0.1)
    for path in plan.trajectories[plan.good]:
        assert not inside(path - (0.5, 0.0, 0.25)).any()
    assert inside(paths[1] - (0.5, 0.0, 0.25)).any()


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        ({"cell": 0.0}, "cell must be"),
        ({"cell": float("nan")}, "cell must be"),
        ({"cell": 0.001}, r"0.5 x 0.3 x 0.2 m, would need about \d+ spheres .* beyond 4096"),
        ({"position": (1, 2)}, "position must have shape"),
        ({"quaternion": (0, 0, 0, 2)}, "quaternion must have norm 1"),
        ({"scale": 0.0}, "scale must be positive"),
        ({"scale": (1.0, 2.0)}, "scale must have shape"),
        ({"scale": 1000.0}, "if its lengths are millimetres, give scale=0.001"),
        ({"mesh": 3}, "mesh must be a path or a trimesh.Trimesh, got int"),
        ({"mesh": "scene.zip"}, "the mesh scene.zip must be of a kind of"),
        ({"mesh": trimesh.Trimesh()}, "triangles of finite size"),
    ],
)
def test_bad_arguments_are_named(arguments, named):
    with pytest.raises(ValueError, match=named):
        mesh_obstacles(**{"mesh": meshes()["box"][0], "cell": CELL, **arguments})


def test_files_that_are_no_mesh_are_named(tmp_path):
    with pytest.raises(FileNotFoundError):
        mesh_obstacles(tmp_path / "none.stl", cell=CELL)
    torn = tmp_path / "torn.obj"
    torn.write_text("v 1 2\nf 9 9 9\n")
    with pytest.raises(ValueError, match=r"torn\.obj"):
        mesh_obstacles(torn, cell=CELL)
