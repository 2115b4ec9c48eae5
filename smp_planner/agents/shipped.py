"""Names of the agents whose actors are shipped, told without loading what acts."""

from __future__ import annotations

__all__ = ["TRAINED_BY"]

TRAINED_BY = {
    "sac_her": "train_agent.py",
    "sac_demonstrations": "train_agent.py --agent sac_demonstrations",
    "cloning": "train_cloning.py --agent cloning",
    "distilled": "train_cloning.py",
}
"""Scripts that train the agents, by the agents' names."""
