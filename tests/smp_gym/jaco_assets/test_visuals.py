"""Lofts and plates against the volume of the bodies they stand for."""

import io

import numpy as np
import pytest
import trimesh

from smp_gym.jaco_assets.visuals import Loft, Plate, obj, visual_bodies


def _mesh(body):
    mesh = trimesh.load_mesh(io.StringIO(obj(body)), file_type="obj", process=False)
    merged = trimesh.Trimesh(mesh.vertices, mesh.faces, process=True)
    merged.merge_vertices(merge_norm=True, digits_vertex=4)
    return merged


@pytest.mark.parametrize("axis", ["y", "z"])
def test_a_loft_of_equal_circles_is_a_prism_of_24_corners(axis):
    mesh = _mesh(Loft(axis, ((0.0, 0.1, -0.1, 0.1, 2.0), (0.2, 0.1, -0.1, 0.1, 2.0))))
    assert mesh.is_watertight
    area = 24 / 2 * 0.1**2 * np.sin(2 * np.pi / 24)
    assert mesh.volume == pytest.approx(0.2 * area, rel=5e-3)
    assert mesh.extents["xyz".index(axis)] == pytest.approx(0.2)


def test_a_plate_is_thinner_at_its_rims():
    square = ((-0.1, -0.1), (0.1, -0.1), (0.1, 0.1), (-0.1, 0.1))
    flat, bevelled = (_mesh(Plate(square, 0.04, bevel)) for bevel in (1e-4, 0.01))
    assert flat.volume == pytest.approx(0.2**2 * 0.04, rel=5e-3)
    assert 0.8 * flat.volume < bevelled.volume < 0.98 * flat.volume


def test_the_packaged_bodies_are_lofts_and_plates():
    kinds = {name: type(body) for name, body in visual_bodies().items()}
    assert {name for name, kind in kinds.items() if kind is Plate} == {"finger", "fingertip"}
    assert set(kinds.values()) == {Loft, Plate}
