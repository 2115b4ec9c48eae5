"""Maps of a problem's stages: those of more bodies begin with those of fewer."""

import numpy as np
import pytest

from smp_gym.scene import TABLE, Obstacle
from smp_planner.occupancy.grid import bake, bake_analytic
from smp_planner.occupancy.shape_networks import ShapeNetworkMap, default_networks
from smp_planner.planning.maps import SceneMaps
from smp_planner.planning.settings import PlanSettings

WORKSPACE = ((-0.3, -0.3, -0.1), (0.3, 0.3, 0.4))
BALL = Obstacle(shape="sphere", position=(0.1, 0.0, 0.2), size=(0.05,) * 3)
BOX = Obstacle(shape="box", position=(-0.1, 0.1, 0.1), size=(0.05, 0.1, 0.05))


@pytest.mark.parametrize("kind", ["shapes", "exact"])
def test_a_map_is_the_same_whatever_it_began_with(kind):
    maps = SceneMaps(PlanSettings(map=kind), 0)
    for obstacles in ((TABLE,), (TABLE, BALL), (BOX,), (BOX, TABLE, BALL), ()):
        whole = (
            bake_analytic(obstacles, WORKSPACE)
            if kind == "exact"
            else bake(ShapeNetworkMap(obstacles, default_networks()), WORKSPACE)
        )
        found = maps.grid(obstacles, WORKSPACE)
        assert maps.grid(obstacles, WORKSPACE) is found
        np.testing.assert_array_equal(found.values, whole.values)
        np.testing.assert_array_equal(found.origin, whole.origin)
