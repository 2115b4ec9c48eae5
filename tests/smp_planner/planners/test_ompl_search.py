"""OMPL's planners as searches: around an obstacle, and where there is no path."""

import importlib.util
import sys

import numpy as np
import pytest

from smp_gym.datasets.demonstrations import Demonstrations
from smp_gym.scene import Obstacle
from smp_planner.collision.edge_check import EdgeChecker
from smp_planner.planners.ompl_search import OMPLPlanner, OMPLSettings, ompl_path
from smp_planner.planners.registry import resolve

SPEC = "ompl=smp_planner.planners.ompl_search:OMPLPlanner"
needs_ompl = pytest.mark.skipif(
    importlib.util.find_spec("ompl") is None, reason="OMPL is not installed"
)


@needs_ompl
@pytest.mark.parametrize("algorithm", ["BITstar", "RRTConnect", "RRTstar"])
def test_a_path_leads_round_a_pillar(planar, algorithm):
    """The stretched arm must fold to pass."""
    pillar = Obstacle(shape="cylinder", position=(1.9, 0.0, 0.0), size=(0.1, 0.1, 1.0))
    checker = EdgeChecker(planar, (pillar,), 0.005)
    start, rng = np.array([-0.8, 0.0]), np.random.default_rng(0)
    goals = np.array([[0.0, 0.0], [0.9, 0.0], [1.0, 0.1]])
    assert not checker.configurations_free(goals)[0]
    assert not checker.edges_free(start[None], goals[1:2])[0]
    path = ompl_path(start, goals, checker, rng, algorithm=algorithm, seconds=20.0)
    assert path is not None
    np.testing.assert_array_equal(path[0], start)
    assert (goals[1:] == path[-1]).all(axis=1).any()
    assert checker.edges_free(path[:-1], path[1:]).all()
    assert ompl_path(start, goals[:1], checker, rng) is None
    assert ompl_path(goals[0], goals[1:], checker, rng) is None


@needs_ompl
def test_a_search_ends_by_the_clock(planar):
    """A wall that the arm cannot pass: no path, and no error."""
    wall = Obstacle(shape="box", position=(1.2, 0.0, 0.0), size=(1.1, 0.05, 1.0))
    checker = EdgeChecker(planar, (wall,), 0.005)
    start, goal = np.array([-1.0, 0.0]), np.array([[1.0, 0.0]])
    assert checker.configurations_free(np.vstack([start, goal])).all()
    assert ompl_path(start, goal, checker, np.random.default_rng(0), seconds=0.3) is None


@needs_ompl
def test_it_is_a_method_of_the_benchmark():
    planner = resolve(SPEC).make(Demonstrations.load("Placement"), {"seconds": 5.0})
    assert isinstance(planner, OMPLPlanner)
    assert planner.settings["seconds"] == 5.0
    assert planner.settings["particles"] == 1


@pytest.mark.parametrize("settings", [{"seconds": 0.0}, {"algorithm": "PRM"}, {"iterations": 9}])
def test_bad_settings_are_refused(settings):
    with pytest.raises(ValueError, match=next(iter(settings))):
        OMPLSettings.model_validate(settings)


def test_without_ompl_the_error_names_the_extra(monkeypatch):
    """As where it is not installed: the import system finds nothing of that name."""
    monkeypatch.setitem(sys.modules, "ompl", None)
    with pytest.raises(ModuleNotFoundError, match=r'pip install "smp-gym\[ompl\]"'):
        OMPLPlanner(Demonstrations.load("Placement"))
