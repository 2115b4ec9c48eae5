"""Against all chains, tried one by one, and around an obstacle that no straight edge passes."""

from functools import partial
from itertools import pairwise, product

import numpy as np

from smp_gym.scene import Obstacle
from smp_planner.collision.edge_check import EdgeChecker
from smp_planner.planners.rrt_connect.layered_search import path_through
from smp_planner.planners.rrt_connect.tree_search import rrt_connect

SEARCH = partial(rrt_connect, iterations=2000, step=0.5)


def length(configurations, velocity):
    return sum(np.linalg.norm((b - a) / velocity) for a, b in pairwise(configurations))


def test_where_all_is_free_the_path_is_the_shortest(planar):
    rng = np.random.default_rng(3)
    layers = [rng.uniform(-1.0, 1.0, (5, 2)) + np.array([0.3 * k, 0.0]) for k in range(4)]
    start = np.zeros(2)
    found = path_through(start, layers, EdgeChecker(planar, ()), rng, SEARCH)
    corners = [found[0][0], *(piece[-1] for piece in found)]
    shortest = min(length([start, *choice], planar.velocity) for choice in product(*layers))
    assert np.isclose(length(corners, planar.velocity), shortest)
    for piece, layer in zip(found, layers, strict=True):
        assert len(piece) == 2
        assert (layer == piece[-1]).all(axis=1).any()


def test_a_gap_is_bridged_by_a_search(planar):
    """The stretched arm must fold to pass the pillar."""
    pillar = Obstacle(shape="cylinder", position=(1.9, 0.0, 0.0), size=(0.1, 0.1, 1.0))
    checker = EdgeChecker(planar, (pillar,), 0.005)
    start = np.array([-1.0, 0.0])
    layers = [np.array([[-0.8, 0.1], [-0.9, 0.0]]), np.array([[0.9, 0.0], [1.0, 0.1]])]
    rng = np.random.default_rng(0)
    found = path_through(start, layers, checker, rng, SEARCH)
    assert len(found[0]) == 2
    assert len(found[1]) > 2
    np.testing.assert_array_equal(found[0][-1], found[1][0])
    for piece in found:
        assert checker.edges_free(piece[:-1], piece[1:]).all()
    hasty = partial(rrt_connect, iterations=1, step=0.01)
    assert path_through(start, layers, checker, rng, hasty) is None


def test_a_layer_in_which_nothing_is_free_ends_the_search(planar):
    pillar = Obstacle(shape="cylinder", position=(2.0, 0.0, 0.0), size=(0.1, 0.1, 1.0))
    checker = EdgeChecker(planar, (pillar,), 0.005)
    layers = [np.array([[-0.5, 0.0]]), np.array([[0.0, 0.0]]), np.array([[0.5, 0.0]])]
    assert (
        path_through(np.array([-1.0, 0.0]), layers, checker, np.random.default_rng(0), SEARCH)
        is None
    )
