"""Training of PPO: rollouts are learned from, and an interruption changes nothing."""

from pathlib import Path
from typing import Any

import gymnasium as gym
import pytest
import torch
from stable_baselines3 import PPO

from smp_gym.observation import observation_space
from smp_gym.registration import environment_id
from smp_planner.agents.acting import load_zip
from smp_planner.agents.decisions import ACTION_REPEAT
from smp_planner.agents.evaluations import read_evaluations
from smp_planner.agents.hyper_parameters import HyperParameters
from smp_planner.agents.shipping import ship_agent
from smp_planner.agents.training import Training

SETTINGS = HyperParameters(
    algorithm="PPO",
    reward="dense",
    environments=2,
    arguments={
        "n_steps": 32,
        "batch_size": 32,
        "n_epochs": 2,
        "learning_rate": {"start": 1e-3, "end": 1e-4},
        "policy_kwargs": {"net_arch": [16]},
    },
)
ROLLOUT = 2 * 32 * SETTINGS.action_repeat
STEPS = 4 * ROLLOUT


class StoppedError(Exception):
    """Stands for an interruption."""


def train(folder: Path, stop_at: int | None = None) -> None:
    def progress(steps: int, rate: float) -> None:
        if stop_at is not None and steps >= stop_at:
            raise StoppedError

    training = Training(
        folder, agent="ppo", task="DrawS", difficulty="none", seed=3, settings=SETTINGS
    )
    try:
        training.run(STEPS, every=ROLLOUT, episodes=1, progress=progress)
        training.finish(1)
    finally:
        training.close()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("ppo") / "at_once"
    train(path)
    return path


def weights(folder: Path) -> dict[str, Any]:
    found: dict[str, Any] = PPO.load(folder / "final.zip", device="cpu").policy.state_dict()
    return found


def test_ppo_learns_from_its_rollouts(folder: Path) -> None:
    steps = [each.steps for each in read_evaluations(folder / "evaluations.csv")]
    assert steps == [ROLLOUT * number for number in range(1, 5)]
    model = PPO.load(folder / "final.zip", device="cpu")
    # Passes over four rollouts.
    assert model._n_updates == 4 * 2
    # The last rollout was learned from at the rate of its beginning, a quarter before the end.
    assert model.policy.optimizer.param_groups[0]["lr"] == pytest.approx(1e-4)


def test_an_interrupted_training_of_ppo_is_equal_to_one_at_once(
    folder: Path, tmp_path: Path
) -> None:
    # In the middle of the third rollout, which is lost.
    with pytest.raises(StoppedError):
        train(tmp_path / "in_parts", stop_at=2 * ROLLOUT + ROLLOUT // 2)
    train(tmp_path / "in_parts")
    at_once, in_parts = weights(folder), weights(tmp_path / "in_parts")
    for name, value in at_once.items():
        assert torch.equal(value, in_parts[name]), name


def test_ppo_is_a_method_as_it_is_saved(folder: Path) -> None:
    agent = load_zip(folder / "agent.zip", "ppo")
    agent.check("DrawS", "exact")
    model = PPO.load(folder / "agent.zip", device="cpu")
    assert vars(model)[ACTION_REPEAT] == SETTINGS.action_repeat
    with gym.make(environment_id("DrawS"), difficulty="easy") as env:
        observation, _ = env.reset(seed=1)
    seen = {key: observation[key] for key in SETTINGS.seen("none")}
    own, _ = agent.predict(observation, deterministic=True)
    theirs, _ = model.predict(seen, deterministic=True)
    assert (own == theirs).all()
    assert set(SETTINGS.seen("easy")) == set(observation_space("DrawS"))


def test_what_is_not_sac_is_not_shipped(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"must hold an agent of SAC to be shipped, got PPO"):
        ship_agent(folder, folder=tmp_path)
    assert not list(tmp_path.iterdir())
