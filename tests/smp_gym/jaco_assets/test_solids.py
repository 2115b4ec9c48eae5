"""The solids of a link and the balls around parts of them, against what geometry says of them."""

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from smp_gym.jaco_assets.solids import Box, Cylinder, clipped, enclosing_ball


def test_signed_distances_are_those_to_the_surface():
    turned = Box((-0.1, -0.2, -0.3), (0.1, 0.2, 0.3), np.pi / 2)
    points = np.array([[0.0, 0.0, 0.0], [0.5, 0.0, 0.0], [0.0, 0.5, 0.0], [0.23, 0.14, 0.0]])
    np.testing.assert_allclose(turned.signed_distance(points), [-0.1, 0.3, 0.4, 0.05], atol=1e-12)
    rod = Cylinder("x", (0.1, 0.0), 0.05, 0.0, 0.4)
    points = np.array([[0.2, 0.1, 0.0], [0.2, 0.1, 0.08], [0.44, 0.1, 0.08], [-0.1, 0.1, 0.0]])
    np.testing.assert_allclose(rod.signed_distance(points), [-0.05, 0.03, 0.05, 0.1], atol=1e-12)


def test_enclosing_ball_is_minimal():
    cube = np.stack(np.meshgrid(*[(0.0, 0.1)] * 3), axis=-1).reshape(-1, 3)
    center, radius = enclosing_ball(cube)
    np.testing.assert_allclose(center, 0.05, atol=1e-4)
    assert np.sqrt(3) / 20 <= radius <= np.sqrt(3) / 20 + 2e-4
    triangle = np.array([(0, 0, 0), (0.1, 0, 0), (0.05, 0.01, 0)])
    assert enclosing_ball(triangle)[1] == pytest.approx(0.05, abs=2e-4)


def test_clipped_shape_has_the_volume_of_the_part():
    half = Box((-1.0, 0.0, -1.0), (1.0, 1.0, 1.0))
    cylinder = Cylinder("z", (0.0, 0.0), 0.05, 0.0, 0.1)
    volume = ConvexHull(clipped(cylinder.hull(), half)).volume
    assert volume == pytest.approx(np.pi * 0.05**2 * 0.1 / 2, rel=2e-3)
    assert volume > np.pi * 0.05**2 * 0.1 / 2
    beside = Box((-1.0, 0.2, -1.0), (1.0, 1.0, 1.0))
    assert clipped(cylinder.hull(), beside).shape == (0, 3)
