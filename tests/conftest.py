"""What all tests share."""

import multiprocessing

import pytest
import torch

from smp_planner.benchmark import worker_pool

# Busy neighbours turn a small matrix product on several threads into a wait.
torch.set_num_threads(1)

# Processes of the kind "forkserver" begin as copies of one that has imported all this, alone and
# once. Those of stable-baselines3 are of that kind.
multiprocessing.set_forkserver_preload(
    ["smp_planner.benchmark.episode_pictures", "stable_baselines3"]
)


@pytest.fixture(scope="session", autouse=True)
def _workers_begin_as_copies():
    """Spare worker processes importing all anew, but where a test sets the library's own start."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(worker_pool, "START", "forkserver")
        yield
