"""Maps of a problem's stages: those of more bodies begin with those of fewer."""

import numpy as np
import pytest

from smp_gym.scene import TABLE, Obstacle
from smp_planner.occupancy.grid import bake, bake_analytic
from smp_planner.occupancy.shape_networks import ShapeNetworkMap, default_networks
from smp_planner.planning.maps import SceneMaps
from smp_planner.planning.settings import PlanSettings
from smp_planner.planning.threads import Threads

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


@pytest.mark.parametrize("kind", ["shapes", "exact"])
@pytest.mark.parametrize("count", [2, 3, 4])
def test_a_map_is_the_same_however_many_threads_make_it(kind, count):
    alone = SceneMaps(PlanSettings(map=kind), 0)
    with Threads(count) as threads:
        shared = SceneMaps(PlanSettings(map=kind), 0, threads=threads)
        for obstacles in ((TABLE, BALL), (BOX, TABLE, BALL)):
            found, expected = (maps.grid(obstacles, WORKSPACE) for maps in (shared, alone))
            np.testing.assert_array_equal(found.values, expected.values)
    slabs = expected.values
    whole = np.full(slabs.shape, slabs.max(), np.float32)
    learned = ShapeNetworkMap((BOX, TABLE, BALL), default_networks())
    if kind == "shapes":
        learned.fill(whole, expected.origin, expected.spacing)
        np.testing.assert_allclose(slabs, whole, atol=1e-7)
