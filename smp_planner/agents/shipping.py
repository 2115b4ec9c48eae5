"""Shipping of trained agents: from the folder of a training into the package, with their scores."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

from smp_planner.benchmark.manifest import read_results
from smp_planner.benchmark.summary import rate_interval
from smp_planner.planners.agent_file import read_agent, shipped_agent, write_agent

__all__ = ["scores_of", "ship_agent"]


def scores_of(results: Path, agent: str, task: str) -> dict[str, Any]:
    """Return an agent's success by cell, with Wilson intervals, and that of methods beside it.

    Args:
        results: folder that ``smp-bench run`` wrote.
        agent: name of the agent's method.
        task: of the cells.

    Raises:
        ResultsError: no results there, or damaged ones.
        ValueError: they hold no episode of the agent and task.
    """
    manifest, rows = read_results(results)
    scores: dict[str, Any] = {}
    for cell in manifest.cells:
        for method in manifest.methods:
            played = [row for row in rows if row.key.cell == cell and row.method == method]
            if cell.task == task and played:
                seeds = [row.seed for row in played]
                rate = rate_interval(sum(row.success for row in played), len(played))
                rounded = {name: round(value, 4) for name, value in rate.items()}
                scores.setdefault(cell.name, {"seeds": [min(seeds), max(seeds)]})[method] = rounded
    if not any(agent in of_cell for of_cell in scores.values()):
        raise ValueError(f"{results} must hold episodes of {agent} on {task}, got none")
    return scores


def ship_agent(card: Path, results: Path | None = None, folder: Path | None = None) -> Path:
    """Write an agent where its method looks for it, and return the path of its card.

    Args:
        card: of the trained agent, or of the shipped one, to give it scores.
        results: folder of ``smp-bench run`` with its episodes; None leaves its scores.
        folder: to write into, in place of the package's.

    Raises:
        OSError: there is no such file.
        ValueError: it is not an agent, or the results are not its.
    """
    policy, known = read_agent(card)
    if results is not None:
        known = dataclasses.replace(known, scores=scores_of(results, known.agent, known.task))
    path = shipped_agent(known.agent, known.task)
    path = path if folder is None else folder / path.name
    write_agent(path, policy, known)
    return path
