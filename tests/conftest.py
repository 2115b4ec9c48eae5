"""What all tests share."""

import torch

# Busy neighbours turn a small matrix product on several threads into a wait.
torch.set_num_threads(1)
