"""Saving of all that is saved, again and again: two contents take each other's place."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import torch

from smp_gym.datasets import frozen
from smp_gym.datasets.demonstrations import Demonstrations
from smp_gym.sampling import sample_scene
from smp_gym.suites import SUITES
from smp_planner import SMP, PlannerPolicy
from smp_planner.agents.evaluations import Evaluation, draw_curve, write_evaluations
from smp_planner.benchmark.episodes import EpisodeRow
from smp_planner.benchmark.exports import write_csv, write_parquet
from smp_planner.benchmark.results_folder import write_json
from smp_planner.experiments.kills.killing import Work
from smp_planner.library.timed_trajectory import TimedTrajectory
from smp_planner.planners.agent_file import AgentCard, read_agent, write_agent
from smp_planner.planners.bump_policy import BumpPolicy, NetworkShape
from smp_planner.planning.settings import PlanSettings

__all__ = ["saving"]

_AGENT = "agent.json"

Save = Callable[[Path], None]


def saving(folder: Path, rounds: int = 12) -> Work:
    """Return the saving of primitive, demonstrations, policy, settings, agent, curves and exports.

    Every file must hold the bytes of one of the two contents at every moment. An agent is two
    files: card and weights of different agents must be refused.

    Args:
        folder: for what undisturbed saving writes.
        rounds: how often each content is saved.
    """
    contents = [_saves(second) for second in (False, True)]
    known: dict[str, list[bytes]] = {}
    for number, saves in enumerate(contents):
        whole = folder / f"content-{number}"
        whole.mkdir(parents=True)
        for name, save in saves.items():
            save(whole / name)
        for path in whole.iterdir():
            known.setdefault(path.name, []).append(path.read_bytes())

    def go_on(out: Path) -> None:
        out.mkdir(parents=True, exist_ok=True)
        for _ in range(rounds):
            for saves in contents:
                for name, save in saves.items():
                    save(out / name)

    def kept(out: Path) -> Mapping[str, str]:
        present = {name: out / name for name in known if (out / name).exists()}
        which = {name: known[name].index(path.read_bytes()) for name, path in present.items()}
        if _AGENT in which:
            _check_agent(out / _AGENT, which)
        return dict.fromkeys(which, "whole")

    return Work("saving", go_on, kept)


def _check_agent(card: Path, which: Mapping[str, int]) -> None:
    """Raise ValueError if an agent can be read whose card is of another than its weights."""
    same = which[card.name] == which[card.with_suffix(".safetensors").name]
    try:
        read_agent(card)
    except ValueError as error:
        if same:
            raise ValueError("an agent that is whole is refused") from error
        return
    if not same:
        raise ValueError("an agent is accepted whose card is of another")


def _saves(second: bool) -> dict[str, Save]:
    """Return how each file of a content is written, by its name."""
    number = 1 + second
    phase = np.linspace(0.0, 1.0, 60)
    bends = (0.2, 0.25, 0.3) if second else (0.4, 0.5)
    paths = [np.stack([phase, bend * np.sin(np.pi * phase)], 1) for bend in bends]
    shown = replace(Demonstrations.load("DrawS"), metadata={"number": number})
    cell = SUITES["standard"][0]
    listed = frozen.FrozenEpisode(
        "witness", number, sample_scene(cell.task, cell.difficulty, number), "smp"
    )
    rows = [
        EpisodeRow("Placement", "promp", "none", k, second, False, "", "", 0.1, 1.0, 0.02, 150)
        for k in range(50)
    ]
    evaluations = [Evaluation(k, 10, number, 0.1 * number, 0.0, 0.5, 0, 9.0) for k in range(9)]
    torch.manual_seed(number)
    policy = BumpPolicy(NetworkShape(12, number), 0.2)
    card = AgentCard("mp_rl", "Placement", 2, vars(policy.shape), {"iterations": number}, {})
    path = number * paths[0]
    timed = TimedTrajectory(("a", "b"), phase, path, path, path, phase)
    saves: dict[str, Save] = {
        "primitive.npz": SMP.fit(paths).save,
        "shown.npz": shown.save,
        "policy.zip": PlannerPolicy.make("promp", "Placement", seed=number).save,
        "settings.json": lambda path: write_json(
            path, {"margin": 0.01 * number, **PlanSettings().model_dump(mode="json")}
        ),
        "list.jsonl.gz": lambda path: frozen.write_episodes(path, {}, [listed]),
        _AGENT: lambda path: write_agent(path, policy, card),
        "timed.csv": timed.save,
        "timed.json": timed.save,
        "evaluations.csv": partial(write_evaluations, evaluations=evaluations),
        "curve.png": partial(draw_curve, evaluations=evaluations, title="curve"),
        "episodes.csv": partial(write_csv, rows=rows),
    }
    if find_spec("pyarrow") is not None:
        saves["episodes.parquet"] = partial(write_parquet, rows=rows)
    return saves
