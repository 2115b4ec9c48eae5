"""How meshes are covered, measured on solids whose covering is known."""

import numpy as np
import trimesh

from smp_gym.jaco_assets.coverage import measure
from smp_gym.jaco_assets.solids import Box

HALF = 0.05


def _surface(half):
    mesh = trimesh.creation.box(np.full(3, 2.0 * half))
    return trimesh.sample.sample_surface(mesh, 40_000, seed=0)[0]


def test_a_box_that_fits_leaves_nothing_outside_and_its_ball_overshoots_at_the_faces():
    ball = np.array([[0.0, 0.0, 0.0, np.sqrt(3) * HALF]])
    found = measure(_surface(HALF), [Box((-HALF,) * 3, (HALF + 1e-9,) * 3)], ball)
    assert found.outside < 1e-3
    assert found.gap < 1e-8
    assert found.shape_overshoot[1] < 3e-3
    # Above the middle of a face, the ball is farthest from the box.
    expected = (np.sqrt(3) - 1) * HALF
    assert abs(found.sphere_overshoot[1] - expected) < 2e-3


def test_a_box_too_small_leaves_out_and_one_too_great_overshoots():
    points, ball = _surface(HALF), np.array([[0.0, 0.0, 0.0, 0.1]])
    small = measure(points, [Box((-0.8 * HALF,) * 3, (0.8 * HALF,) * 3)], ball)
    assert small.outside == 1.0
    assert 0.2 * HALF < small.gap <= np.sqrt(3) * 0.2 * HALF + 1e-9
    great = measure(points, [Box((-1.2 * HALF,) * 3, (1.2 * HALF,) * 3)], ball)
    assert great.outside == great.gap == 0.0
    assert 0.2 * HALF - 1e-3 < great.shape_overshoot[0] < great.shape_overshoot[1]
