"""Trainings with checkpoints, small enough to be killed often: SAC with HER, and policy search."""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import numpy as np
import torch
from safetensors.torch import load_file

from smp_gym.observation import MAX_EPISODE_STEPS
from smp_planner.agents.bump_training import BumpSettings, BumpTraining
from smp_planner.agents.evaluations import read_evaluations
from smp_planner.agents.hyper_parameters import GripperOpeningSettings, HyperParameters
from smp_planner.agents.training import Training
from smp_planner.experiments.kills.killing import Work

__all__ = ["policy_search", "reinforcement_learning"]

_REPEAT = 5

_SAC = HyperParameters(
    hidden=("released",),
    action_repeat=_REPEAT,
    gripper_openings=GripperOpeningSettings(probability=0.1, decisions=3),
    arguments={
        # Hindsight needs an episode that has ended.
        "learning_starts": MAX_EPISODE_STEPS // _REPEAT,
        "batch_size": 32,
        "buffer_size": 1000,
        "policy_kwargs": {"net_arch": [16]},
    },
    her={"n_sampled_goal": 4, "goal_selection_strategy": "future"},
)

_SEARCH = BumpSettings(scenes=3, batch=3, rollouts=4, epochs=2, bumps=2)


def reinforcement_learning(steps: int = 900, every: int = 150) -> Work:
    """Return a training of SAC with hindsight experience replay on Placement.

    Args:
        steps: environment steps in all, more than an episode's limit.
        every: steps between evaluations.
    """

    def train(folder: Path) -> None:
        training = Training(
            folder, agent="sac_her", task="Placement", difficulty="none", seed=0, settings=_SAC
        )
        training.run(steps, every=every, episodes=1, progress=lambda done, rate: None)
        training.finish(1)
        training.close()

    def evaluations(folder: Path) -> Mapping[int, Any]:
        for name in ("agent", "final"):
            _weights(folder / f"{name}.zip")
        for path in (folder / "run.json", folder / "result.json"):
            if path.exists():
                json.loads(path.read_text())
        return {each.steps: each for each in read_evaluations(folder / "evaluations.csv")}

    def result(folder: Path) -> Any:
        agents = [_weights(folder / f"{name}.zip") for name in ("agent", "final")]
        return agents, (folder / "result.json").read_text()

    return Work("training (SAC)", train, evaluations, result)


def policy_search(iterations: int = 8) -> Work:
    """Return a training of `mp_rl` on scenes of Placement.

    Args:
        iterations: each of which is kept.
    """

    def train(folder: Path) -> None:
        training = BumpTraining(
            folder,
            agent="mp_rl",
            task="Placement",
            difficulties=("easy",),
            seed=0,
            settings=_SEARCH,
        )
        training.run(iterations, every=1)
        training.close()

    def curve(folder: Path) -> Mapping[str, Any]:
        path = folder / "curve.csv"
        lines = path.read_text().splitlines()[1:] if path.exists() else []
        rows = [line.split(",") for line in lines]
        # Without the seconds.
        return {number: (done, *measured) for number, done, _, *measured in rows}

    def result(folder: Path) -> Any:
        weights = load_file(folder / "agent.safetensors")
        card = json.loads((folder / "agent.json").read_text())
        card["training"].pop("cpu_seconds")
        return _digest({name: value.numpy() for name, value in weights.items()}), card

    return Work("training (mp_rl)", train, curve, result)


def _weights(path: Path) -> str:
    """Return a digest of the weights of an agent of stable-baselines3; of none if there is none."""
    if not path.exists():
        return ""
    with ZipFile(path) as archive:
        content = io.BytesIO(archive.read("policy.pth"))
    state = torch.load(content, weights_only=True)
    return _digest({name: value.numpy() for name, value in state.items()})


def _digest(arrays: Mapping[str, Any]) -> str:
    parts = (
        name.encode() + np.ascontiguousarray(array).tobytes() for name, array in arrays.items()
    )
    return hashlib.sha256(b"".join(parts)).hexdigest()
