"""Spheres around bodies: nothing of a body is left out, and nothing stands out beyond the bound."""

import numpy as np
import pybullet_data
import pytest
import trimesh

from smp_planner.library.covering import cover_link
from smp_planner.library.tight_cover import closed_mesh, tight_cover
from smp_planner.library.urdf_reading import Link, Shape

# Bodies whose distance is known: boxes, balls, cylinders as (shape, size of `Shape`).
SOLIDS = [
    ("box", (0.1, 0.1, 0.1)),
    ("box", (0.4, 0.06, 0.2)),
    ("box", (0.01, 0.01, 0.01)),
    ("box", (0.15, 0.1, 0.002)),
    ("cylinder", (0.4, 0.05)),
    ("cylinder", (0.01, 0.1)),
    ("cylinder", (0.2, 0.004)),
    ("sphere", (0.07,)),
]


def outside(kind, size, points):
    """Return the distance (N) m of points from a solid, 0 inside, from its formula."""
    if kind == "sphere":
        return np.maximum(np.linalg.norm(points, axis=1) - size[0], 0.0)
    if kind == "box":
        return np.linalg.norm(np.maximum(np.abs(points) - np.array(size) / 2, 0.0), axis=1)
    across = np.maximum(np.hypot(points[:, 0], points[:, 1]) - size[1], 0.0)
    return np.hypot(across, np.maximum(np.abs(points[:, 2]) - size[0] / 2, 0.0))


def drawn_inside(kind, size, rng):
    """Return points of a solid, half of them where a random ray leaves it."""
    half = {
        "box": lambda: np.array(size) / 2,
        "cylinder": lambda: np.array([size[1], size[1], size[0] / 2]),
        "sphere": lambda: np.full(3, size[0]),
    }[kind]()
    points = rng.uniform(-half, half, (20_000, 3))
    points = points[outside(kind, size, points) == 0.0]
    scale = {
        "box": np.abs(points / half).max(axis=1),
        "sphere": np.linalg.norm(points / half, axis=1),
        "cylinder": np.maximum(np.hypot(*(points / half)[:, :2].T), np.abs(points / half)[:, 2]),
    }[kind]
    return np.concatenate([points, points / scale[:, None]])


def on_spheres(spheres, rng, count=1000):
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return (spheres[:, None, :3] + directions * spheres[:, None, 3:]).reshape(-1, 3)


def largest_gap(spheres, points):
    """Return how far the worst of points (N, 3) is out of the spheres, m."""
    gap = np.full(len(points), np.inf)
    for x, y, z, radius in spheres:
        gap = np.minimum(gap, np.linalg.norm(points - (x, y, z), axis=1) - radius)
    return gap.max()


@pytest.mark.parametrize(("kind", "size"), SOLIDS)
@pytest.mark.parametrize("overshoot", [0.01, 0.03])
def test_solids_are_held_and_not_by_more_than_the_bound(kind, size, overshoot):
    turn = trimesh.transformations.euler_matrix(0.3, -0.8, 1.1)
    turn[:3, 3] = 0.3, -0.1, 0.2
    link = Link("part", (Shape(kind, turn, np.array(size)),), True)
    spheres = cover_link(link, overshoot)
    spheres[:, :3] = (spheres[:, :3] - turn[:3, 3]) @ turn[:3, :3]
    rng = np.random.default_rng(0)
    assert largest_gap(spheres, drawn_inside(kind, size, rng)) <= 1e-9
    standing = outside(kind, size, on_spheres(spheres, rng))
    assert standing.max() <= overshoot + 1e-9
    assert standing.max() > 0.1 * overshoot or kind == "sphere"


def test_a_known_cover_is_not_much_beaten():
    # A ball of radius r in a cube of half side a > r - b: one ball does for a ball that is bound.
    ball = trimesh.creation.icosphere(4, 0.1)
    assert len(tight_cover(ball, 0.02)) <= 4
    # Balls on the axis of a rod, 2 sqrt(R^2 - r^2) apart, hold it but for its ends.
    rod = trimesh.creation.capsule(0.5, 0.05)
    on_axis = 0.5 / (2.0 * np.sqrt(0.07**2 - 0.05**2))
    assert len(tight_cover(rod, 0.02)) <= 2.0 * (on_axis + 1.0)


@pytest.mark.parametrize("number", [2, 4, 6])
def test_links_of_a_robot_are_held(number):
    """Open meshes of a public arm: distances by trimesh, of the closed one."""
    mesh = trimesh.load(f"{pybullet_data.getDataPath()}/kuka_iiwa/meshes/link_{number}.stl")
    assert not mesh.is_watertight
    spheres = tight_cover(mesh, 0.02)
    closed = closed_mesh(mesh)
    _, faces = np.unique(np.sort(closed.edges, axis=1), axis=0, return_counts=True)
    assert faces.min() == 2
    assert np.isclose(closed.area, mesh.area, rtol=0.2)
    rng = np.random.default_rng(0)
    lower, upper = closed.bounds
    surface = closed.sample(30_000, seed=0)
    assert largest_gap(spheres, surface) <= 1e-9
    # Inside is where the winding number is 1 (van Oosterom & Strackee 1983).
    points = rng.uniform(lower, upper, (3000, 3))
    inside = winding(closed, points) > 0.5
    assert 0.2 < inside.mean() < 0.9
    assert largest_gap(spheres, points[inside]) <= 1e-9
    far = on_spheres(spheres, rng, 60)
    far = far[winding(closed, far) < 0.5]
    distance = np.abs(trimesh.proximity.closest_point_naive(closed, far[:400])[1])
    assert distance.max() <= 0.02 + 1e-6


def winding(mesh, points):
    total = np.zeros(len(points))
    for triangle in np.asarray(mesh.triangles):
        a, b, c = (corner - points for corner in triangle)
        la, lb, lc = (np.linalg.norm(side, axis=1) for side in (a, b, c))
        top = np.einsum("ij,ij->i", a, np.cross(b, c))
        dots = [np.einsum("ij,ij->i", x, y) for x, y in ((a, b), (b, c), (c, a))]
        bottom = la * lb * lc + dots[0] * lc + dots[1] * la + dots[2] * lb
        total += np.arctan2(top, bottom)
    return np.abs(total / (2.0 * np.pi))


def test_what_is_enclosed_counts_and_what_is_open_stays_free():
    room = trimesh.util.concatenate(
        [trimesh.creation.box((0.2, 0.2, 0.2)), trimesh.creation.box((0.1, 0.1, 0.1))]
    )
    assert largest_gap(tight_cover(room, 0.02), np.zeros((1, 3))) < 0.0
    # A channel of 0.1 m between two plates: its middle belongs to nothing.
    plates = [trimesh.creation.box((0.2, 0.2, 0.02)) for _ in range(2)]
    for side, plate in zip((-0.06, 0.06), plates, strict=True):
        plate.apply_translation((0.0, 0.0, side))
    spheres = tight_cover(trimesh.util.concatenate(plates), 0.02)
    grid = np.stack(np.meshgrid(*[np.linspace(-0.1, 0.1, 9)] * 2), axis=-1).reshape(-1, 2)
    middle = np.column_stack([grid, np.zeros(len(grid))])
    gaps = np.linalg.norm(middle[:, None] - spheres[:, :3], axis=-1) - spheres[:, 3]
    assert gaps.min() >= 0.05 - 0.02 - 1e-9


def test_sheets_are_held():
    sheet = trimesh.Trimesh([[0, 0, 0], [0.2, 0, 0], [0.2, 0.1, 0], [0, 0.1, 0]], [[0, 1, 2]])
    spheres = tight_cover(sheet, 0.02)
    assert largest_gap(spheres, sheet.sample(2000, seed=0)) <= 1e-9
    rise = np.abs(spheres[:, 2]) + spheres[:, 3]
    assert rise.max() <= 0.02 + 1e-9


def test_the_same_mesh_gets_the_same_spheres():
    mesh = trimesh.creation.torus(0.1, 0.03)
    np.testing.assert_array_equal(tight_cover(mesh, 0.015), tight_cover(mesh.copy(), 0.015))
    # The hole of the ring, 0.07 m in radius, stays free up to the bound.
    spheres = tight_cover(mesh, 0.015)
    assert (np.linalg.norm(spheres[:, :3], axis=1) - spheres[:, 3]).min() >= 0.07 - 0.015 - 1e-9


def test_what_is_too_large_is_refused():
    with pytest.raises(ValueError, match="cells, beyond"):
        tight_cover(trimesh.creation.box((9.0, 9.0, 9.0)), 0.01)
    with pytest.raises(ValueError, match=r"more than \d+ triangles"):
        tight_cover(trimesh.creation.box((5.0, 5.0, 1e-9)), 0.01)
