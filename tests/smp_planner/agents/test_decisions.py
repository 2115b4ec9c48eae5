"""Decisions that last several steps: the same in acting as in training, whatever they hold."""

from itertools import pairwise

import gymnasium as gym
import numpy as np
import pytest

from smp_gym.env import ManipulationEnv
from smp_gym.rollout import rollout
from smp_planner.agents.acting import RandomActions, load_zip
from smp_planner.agents.decisions import ACTION_REPEAT, ActionRepeat, HeldActions, acting

DENSE = "smp_gym/PlacementDense-v0"


@pytest.fixture
def env():
    with gym.make(DENSE, difficulty="none", max_episode_steps=23) as env:
        yield env


def test_holding_actions_is_repeating_them(env):
    """Random actions depend on the observation of the decision, so both must decide alike."""
    seen = []
    held = rollout(env, HeldActions(RandomActions(), 5), seed=3, recorders=[seen.append])
    actions = np.array([moment.action for moment in seen[1:]])
    assert len(np.unique(actions, axis=0)) == -(-len(actions) // 5)
    for start in range(0, len(actions), 5):
        assert (actions[start : start + 5] == actions[start]).all()
    decisions = []
    repeated = rollout(ActionRepeat(env, 5), RandomActions(), seed=3, recorders=[decisions.append])
    assert repeated.steps == -(-held.steps // 5)
    assert repeated.reward == pytest.approx(held.reward)
    for key, value in held.last.items():
        np.testing.assert_array_equal(repeated.last[key], value)
    # The goal achieved before a decision is that of the decision before.
    for before, after in pairwise(decisions):
        np.testing.assert_array_equal(
            after.info["previous_achieved_goal"], before.observation["achieved_goal"]
        )


def test_an_episode_that_ends_within_a_decision_ends(env):
    repeated = ActionRepeat(env, 10)
    repeated.reset(seed=0)
    down = np.array([0, 1, 0, 0, 0, 0, 0], np.float32)
    outcomes = [repeated.step(0 * down)[2:4] for _ in range(3)]
    assert outcomes == [(False, False), (False, False), (False, True)]
    inner = env.unwrapped
    assert isinstance(inner, ManipulationEnv)
    assert inner.limit == 23


def test_how_long_a_decision_lasts_stands_in_the_file_of_an_agent(tmp_path):
    sb3 = pytest.importorskip("stable_baselines3")
    env = gym.make("smp_gym/Placement-v0", difficulty="none")
    model = sb3.PPO("MultiInputPolicy", env, n_steps=8, batch_size=8, device="cpu")
    assert acting(model) is model
    setattr(model, ACTION_REPEAT, 4)
    model.save(tmp_path / "agent.zip")
    loaded = load_zip(tmp_path / "agent.zip", "mine")
    seen = []
    rollout(env, loaded, seed=0, steps=9, recorders=[seen.append])
    actions = [moment.action for moment in seen[1:]]
    changes = [n for n in range(1, 9) if not np.array_equal(actions[n], actions[n - 1])]
    assert changes == [4, 8]
    env.close()


@pytest.mark.parametrize("times", [0, -1, 2.5, "two"])
def test_other_lengths_of_decisions_are_refused(tmp_path, times):
    sb3 = pytest.importorskip("stable_baselines3")
    env = gym.make("smp_gym/Placement-v0", difficulty="none")
    model = sb3.PPO("MultiInputPolicy", env, n_steps=8, batch_size=8, device="cpu")
    setattr(model, ACTION_REPEAT, times)
    model.save(tmp_path / "agent.zip")
    with pytest.raises(ValueError, match="agent 'mine': action_repeat of an agent must be"):
        load_zip(tmp_path / "agent.zip", "mine")
    env.close()
