import pytest
import torch
from batch_problems import ROUND, problem_of

from smp_gym.sampling import sample_scene
from smp_planner.planners import make_planner


@pytest.fixture(scope="session")
def planner():
    """A planner on the exact map, small enough for tests."""
    settings = {"map": "exact", "particles": 4, "iterations": 8, "retries": 0}
    # The wider apart samples are, the more there is to be checked between them.
    settings |= {"samples": 200, "planning_steps": 30, "inference": "quick", "widths": (1.0,)}
    return make_planner("smp", "Placement", settings=settings)


@pytest.fixture(scope="session")
def problems():
    """Two scenes of different numbers of obstacles and spheres, one with round obstacles."""
    return [
        problem_of(_thinned(70_001, 2), 1, ROUND),
        problem_of(_thinned(70_002, 3), 2, half_extents=(0.02, 0.02, 0.05)),
    ]


def _thinned(seed, count):
    """Return a scene with so many of its obstacles: few iterations find particles that are good."""
    scene = sample_scene("Placement", "easy", seed)
    return scene.model_copy(update={"obstacles": scene.obstacles[:count]})


@pytest.fixture(scope="session")
def paths(problems):
    """Paths (2, 4, 20, 6) rad all over the place, so that all costs have something to say."""
    generator = torch.Generator().manual_seed(3)
    start = torch.stack([torch.from_numpy(p.start) for p in problems])[:, None, None]
    steps = torch.randn(2, 4, 20, 6, generator=generator, dtype=torch.float64)
    return (start + 0.25 * steps.cumsum(2)).contiguous()
