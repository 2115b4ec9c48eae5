"""What all tests share."""

import multiprocessing

import torch

# Busy neighbours turn a small matrix product on several threads into a wait.
torch.set_num_threads(1)

# Processes of the kind "forkserver" begin as copies of one that has imported all this, alone and
# once. Those of stable-baselines3 are of that kind.
multiprocessing.set_forkserver_preload(
    ["smp_planner.benchmark.episode_pictures", "stable_baselines3"]
)
