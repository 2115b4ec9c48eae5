"""The planners that can be made for a task: those that learn nothing in advance, or are shipped."""

from smp_planner.planners import PLANNERS
from smp_planner.planners.bump_planner import LEARNED
from smp_planner.planners.card_file import shipped_agent


def planners_of(task: str) -> list[str]:
    """Return the names of `PLANNERS` but for those whose agent is not shipped for a task."""
    return [n for n in PLANNERS if n not in LEARNED or shipped_agent(n, task).exists()]
