"""Rows of covers of public arms: bounds are kept, and what stands out of known bodies."""

import numpy as np
import pytest
import trimesh

from smp_planner.experiments.link_covers import covers_table, link_covers, standing_out


def test_how_far_spheres_stand_out_is_that_of_known_bodies():
    box = trimesh.creation.box((0.2, 0.2, 0.2))
    inside = np.array([[0.0, 0.0, 0.0, 0.1]])
    beside = np.array([[0.1, 0.0, 0.0, 0.03]])
    around = np.array([[0.0, 0.0, 0.0, 0.2]])
    found = standing_out(box, [inside, beside, around])
    assert found == pytest.approx([0.0, 0.03, 0.1], abs=0.004)


def test_a_bound_is_kept_with_fewer_spheres_than_cells():
    cells, bound = link_covers("kuka_iiwa", [0.03], planned=False)
    assert (cells.kind, bound.kind, bound.size) == ("cells", "bound", 0.03)
    assert bound.overshoot < 0.0315 < cells.overshoot
    assert sum(bound.spheres) < sum(cells.spheres)
    assert len(bound.spheres) == len(cells.spheres) == 8
    assert len(covers_table([cells, bound]).rows) == 2
