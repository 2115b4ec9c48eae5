"""Shipping of trained agents: from the folder of a training into the package, with their scores."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any, TypeGuard

from torch import nn

from smp_gym.optional_packages import require
from smp_gym.registration import task_of
from smp_planner.agents.actor_file import Actor, ActorCard, is_actor, read_actor, write_actor
from smp_planner.agents.decisions import CPU_SECONDS
from smp_planner.benchmark.manifest import read_results
from smp_planner.benchmark.summary import rate_interval
from smp_planner.planners.agent_file import AgentCard, read_agent, write_agent
from smp_planner.planners.bump_policy import BumpPolicy
from smp_planner.planners.card_file import shipped_agent

__all__ = ["actor_of", "scores_of", "ship_agent"]


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


def actor_of(folder: Path) -> tuple[Actor, ActorCard]:
    """Return the actor of a training that has ended, as `smp_planner.agents.training` has left it.

    Reads ``final.zip``, which runs pickled code: give only folders of your own.

    Args:
        folder: of the training.

    Raises:
        ValueError: no finished training there, one of another algorithm or of an older version, or
            one whose network is not that of an `Actor`.
    """
    require("rl", "smp_planner.agents.shipping.actor_of")
    from stable_baselines3 import SAC

    try:
        run = json.loads((folder / "run.json").read_text())
        agent, settings = run["agent"], run["settings"]
        algorithm, layers = (
            settings["algorithm"],
            settings["arguments"]["policy_kwargs"]["net_arch"],
        )
    except OSError as error:
        raise ValueError(f"{folder} must hold a finished training: {error}") from None
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{folder} holds a training of an older version: no {error}") from None
    if isinstance(layers, dict):
        layers = layers["pi"]
    if algorithm != "SAC":
        raise ValueError(
            f"{folder} must hold an agent of SAC to be shipped, got {algorithm}; its final.zip is "
            "a method as it is, name=final.zip"
        )
    try:
        model = SAC.load(folder / "final.zip", device="cpu")
    except OSError as error:
        raise ValueError(f"{folder} must hold a finished training: {error}") from None
    steps = model.num_timesteps * settings["action_repeat"]
    card = ActorCard(
        agent=agent,
        task=task_of(run["environment"]),
        entries=sorted(model.observation_space),  # type: ignore[call-overload]
        hidden=settings["hidden"],
        action_repeat=settings["action_repeat"],
        layers=layers,
        training={**run, "steps": steps, "cpu_seconds": round(getattr(model, CPU_SECONDS), 1)},
        scores={},
    )
    actor = Actor(card)
    linear = [layer for layer in (*model.actor.latent_pi, model.actor.mu) if _has_weights(layer)]
    ours = [layer for layer in actor.layers if _has_weights(layer)]
    if [layer.weight.shape for layer in linear] != [layer.weight.shape for layer in ours]:
        raise ValueError(f"{folder} holds layers {linear}, which are not those of an Actor: {ours}")
    for own, other in zip(ours, linear, strict=True):
        own.load_state_dict(other.state_dict())
    return actor.requires_grad_(False), card


def _has_weights(layer: nn.Module) -> TypeGuard[nn.Linear]:
    return isinstance(layer, nn.Linear)


def ship_agent(source: Path, results: Path | None = None, folder: Path | None = None) -> Path:
    """Write an agent where its method looks for it, and return the path of its card.

    Args:
        source: card of a trained or a shipped agent, to give it scores; or the folder of a training
            of SAC, see `actor_of`.
        results: folder of ``smp-bench run`` with its episodes; None leaves its scores.
        folder: to write into, in place of the package's.

    Raises:
        OSError: there is no such file.
        ValueError: it is not an agent, or the results are not its.
    """
    module: Actor | BumpPolicy
    known: ActorCard | AgentCard
    if source.is_dir():
        module, known = actor_of(source)
    elif is_actor(source):
        module, known = read_actor(source)
    else:
        module, known = read_agent(source)
    if results is not None:
        scores = scores_of(results, known.agent, known.task)
        known = dataclasses.replace(known, scores=scores)
    path = shipped_agent(known.agent, known.task)
    path = path if folder is None else folder / path.name
    if isinstance(known, ActorCard):
        assert isinstance(module, Actor)
        write_actor(path, module, known)
    else:
        assert isinstance(module, BumpPolicy)
        write_agent(path, module, known)
    return path
