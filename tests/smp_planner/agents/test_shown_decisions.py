"""What a learning agent is shown: decisions that lead where the planner went, and batches."""

from functools import partial
from itertools import islice
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch
from stable_baselines3 import SAC
from stable_baselines3.common.env_util import make_vec_env

from smp_gym.env import FAILURE_REWARD, SUCCESS_REWARD
from smp_gym.registration import environment_id
from smp_gym.sampling import sample_scene
from smp_planner.agents.acting import load_zip
from smp_planner.agents.actor_file import read_actor
from smp_planner.agents.checkpoints import load_checkpoint, save_checkpoint
from smp_planner.agents.decisions import ActionRepeat
from smp_planner.agents.evaluations import read_evaluations
from smp_planner.agents.hyper_parameters import DemonstrationSettings, HyperParameters
from smp_planner.agents.learners import class_of, make_model
from smp_planner.agents.shipping import ship_agent
from smp_planner.agents.shown_decisions import FIRST_SEED, shown_episodes
from smp_planner.agents.training import Training

REPEAT = 5
SETTINGS = HyperParameters(
    arguments={
        "learning_starts": 40,
        "batch_size": 40,
        "buffer_size": 400,
        "ent_coef": 0.001,
        "policy_kwargs": {"net_arch": {"pi": [64, 48], "qf": [64, 64]}, "n_critics": 3},
    },
    demonstrations=DemonstrationSettings(
        episodes=3, share=0.25, cloning_steps=600, critic_decisions=80
    ),
)


@pytest.fixture(scope="module")
def episodes():
    with gym.make(environment_id("Placement"), difficulty="none") as env:
        return list(islice(shown_episodes(env, "Placement", "none", 0, REPEAT), 3))


@pytest.fixture
def model(episodes):
    env = make_vec_env(
        environment_id("Placement"),
        env_kwargs={"difficulty": "none"},
        wrapper_class=partial(ActionRepeat, times=REPEAT),
    )
    made: Any = make_model(env, "Placement", SETTINGS, seed=0)
    made.replay_buffer.show(episodes)
    yield made
    env.close()


def test_shown_decisions_succeed_in_the_physics(episodes):
    """The mean of the rates in the steps of a decision, held, comes to the same place."""
    with gym.make(environment_id("Placement")) as plain:
        env = ActionRepeat(plain, REPEAT)
        for number, episode in enumerate(episodes):
            observation, _ = env.reset(
                options={"scene": sample_scene("Placement", "none", FIRST_SEED + number)}
            )
            np.testing.assert_array_equal(
                observation["observation"], episode[0].before["observation"]
            )
            assert sum(decision.reward for decision in episode) == SUCCESS_REWARD
            assert [d.terminated for d in episode] == [False] * (len(episode) - 1) + [True]
            terminated, info = False, {}
            for decision in episode:
                if not terminated:
                    observation, _, terminated, _, info = env.step(decision.action)
            while not terminated:
                observation, _, terminated, _, info = env.step(episode[-1].action)
            assert info["is_success"]


def test_decisions_may_begin_at_every_step(episodes):
    with gym.make(environment_id("Placement"), difficulty="none") as env:
        every = next(shown_episodes(env, "Placement", "none", 0, REPEAT, stride=1))
    assert REPEAT * (len(episodes[0]) - 1) < len(every) <= REPEAT * len(episodes[0])
    for decision, following in zip(every[::REPEAT], episodes[0], strict=True):
        np.testing.assert_array_equal(decision.action, following.action)
        for seen, other in ((decision.before, following.before), (decision.after, following.after)):
            np.testing.assert_array_equal(seen["observation"], other["observation"])
    # Each that lasts until the end of the episode ends it, and has its reward.
    ends = [decision.terminated for decision in every]
    assert ends == [False] * (len(every) - REPEAT) + [True] * REPEAT
    assert [decision.reward for decision in every] == [SUCCESS_REWARD * end for end in ends]


def test_a_share_of_each_batch_is_what_was_shown(model, episodes):
    model.learn(161)
    actions = {tuple(decision.action.tolist()) for episode in episodes for decision in episode}
    batch = model.replay_buffer.sample(40)
    shown = [tuple(row.tolist()) in actions for row in batch.actions]
    assert shown == [True] * 10 + [False] * 30
    assert batch.rewards.shape == batch.dones.shape == (40, 1)


def test_the_actor_learns_to_do_what_was_shown(model, episodes):
    def error() -> float:
        found = [
            model.predict(decision.before, deterministic=True)[0] - decision.action
            for episode in episodes
            for decision in episode
        ]
        return float(np.square(found).mean())

    before = error()
    model.clone()
    assert error() < 0.3 * before


def test_the_critic_learns_before_the_actor_does(model):
    def weights() -> tuple[torch.Tensor, torch.Tensor]:
        parts = (model.actor, model.critic)
        return tuple(
            torch.cat([value.detach().flatten() for value in part.parameters()]) for part in parts
        )

    actor, critic = weights()
    model.learn(79)
    assert torch.equal(weights()[0], actor)
    assert not torch.equal(weights()[1], critic)
    model.learn(20, reset_num_timesteps=False)
    assert not torch.equal(weights()[0], actor)


def test_values_of_what_nobody_has_tried_are_bounded(model, episodes):
    """A normalised layer of N has at most the norm sqrt(N), whatever comes before it."""
    model.learn(79)
    seen = {
        key: torch.as_tensor(value)[None].expand(1000, -1)
        for key, value in episodes[0][0].before.items()
    }
    actions = 1e4 * torch.randn((1000, 7), generator=torch.Generator().manual_seed(0))
    networks = model.critic.q_networks
    assert len(networks) == 3
    with torch.no_grad():
        for network, value in zip(networks, model.critic(seen, actions), strict=True):
            normed, last = network[4], network[-1]
            largest = normed.weight.abs().max() * 64**0.5 + normed.bias.norm()
            assert value.abs().max() <= last.bias.abs() + last.weight.norm() * largest
    plain = SAC("MultiInputPolicy", model.get_env(), policy_kwargs={"net_arch": [64, 64]}, seed=0)
    assert plain.critic(seen, actions)[0].abs().max() > 100.0


def test_targets_are_returns_that_there_can_be(model):
    model.learn(79)
    batch = model.replay_buffer.sample(400)
    over, rewards = 1.0 - batch.dones, batch.rewards
    assert set(rewards.flatten().tolist()) >= {0.0, SUCCESS_REWARD}
    for bias, bound in ((1e6, SUCCESS_REWARD), (-1e6, FAILURE_REWARD)):
        for network in model.critic_target.q_networks:
            torch.nn.init.constant_(network[-1].bias, bias)
        torch.testing.assert_close(model.targets(batch), rewards + 0.99 * bound * over)


def test_a_target_is_the_lesser_of_a_random_pair(model):
    model.learn(79)
    batch = model.replay_buffer.sample(10)
    for value, network in enumerate(model.critic_target.q_networks):
        torch.nn.init.zeros_(network[-1].weight)
        torch.nn.init.constant_(network[-1].bias, float(value))
    going_on = batch.dones[:, 0] == 0.0
    found = {
        round(float(((model.targets(batch) - batch.rewards)[going_on] / 0.99).mean()), 4)
        for _ in range(40)
    }
    assert found == {0.0, 1.0}


def test_an_interrupted_training_is_equal_to_one_at_once(tmp_path):
    """Over the moment in which the actor begins to learn."""
    shown = DemonstrationSettings(episodes=1, cloning_steps=10, critic_decisions=50)
    settings = SETTINGS.model_copy(update={"demonstrations": shown})
    models = []
    for folder, parts in (("parts", (240, 300)), ("at_once", (300,))):
        for steps in parts:
            training = Training(
                tmp_path / folder, agent="sac_demonstrations", task="Placement",
                difficulty="none", seed=0, settings=settings,
            )  # fmt: skip
            training.run(steps, every=1000, episodes=1, progress=lambda done, rate: None)
            training.close()
        models.append(training.model)
    for part in ("policy", "actor.optimizer", "critic.optimizer"):
        one, other = (model.get_parameters()[part] for model in models)
        torch.testing.assert_close(one, other, rtol=0.0, atol=0.0)
    own, theirs = (vars(model)["replay_buffer"] for model in models)
    np.testing.assert_array_equal(own.actions, theirs.actions)
    assert own.pos == 60


def test_what_was_shown_is_in_the_checkpoint(model, episodes, tmp_path):
    model.learn(100)
    save_checkpoint(model, tmp_path)
    again: Any = load_checkpoint(tmp_path, model.get_env(), class_of(SETTINGS))
    shown = again.replay_buffer.shown
    assert shown.size() == sum(map(len, episodes))
    np.testing.assert_array_equal(shown.actions, model.replay_buffer.shown.actions)
    again.learn(20, reset_num_timesteps=False)
    assert again.num_timesteps == 120


def test_what_was_trained_acts_as_an_agent_of_sac(model, episodes, tmp_path):
    model.save(tmp_path / "agent.zip")
    agent = load_zip(tmp_path / "agent.zip", "shown")
    seen = episodes[0][0].before
    held, _ = agent.predict(seen, deterministic=True)
    own, _ = model.predict(seen, deterministic=True)
    np.testing.assert_array_equal(held, own)


def test_a_training_is_shown_episodes_once_and_measured_before_it_learns(tmp_path):
    shown = []
    for steps in (300, 600):
        training = Training(
            tmp_path / "shown",
            agent="sac_demonstrations",
            task="Placement",
            difficulty="none",
            seed=0,
            settings=SETTINGS,
        )
        training.show(lambda done, total: shown.append((done, total)))
        training.run(steps, every=300, episodes=1, progress=lambda done, rate: None)
        training.close()
    assert shown == [(1, 3), (2, 3), (3, 3)]
    evaluations = read_evaluations(tmp_path / "shown" / "evaluations.csv")
    assert [each.steps for each in evaluations] == [0, 300, 600]


def test_a_shipped_actor_of_layers_of_its_own_acts_as_the_agent_did(episodes, tmp_path):
    training = Training(
        tmp_path,
        agent="sac_demonstrations",
        task="Placement",
        difficulty="none",
        seed=0,
        settings=SETTINGS,
    )
    training.model.save(tmp_path / "final.zip")
    training.close()
    actor, card = read_actor(ship_agent(tmp_path, folder=tmp_path))
    assert card.layers == [64, 48]
    for decision in episodes[0]:
        seen = {key: decision.before[key] for key in training.model.observation_space}
        theirs, _ = training.model.predict(seen, deterministic=True)
        np.testing.assert_allclose(actor.predict(decision.before)[0], theirs, atol=2e-3)
