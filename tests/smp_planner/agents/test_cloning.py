"""Behaviour cloning: labels under disturbance, resuming, an agent that imitates, refusals."""

import json

import gymnasium
import numpy as np
import pytest
import torch

from smp_gym.folder_lock import FolderInUseError
from smp_gym.observation import state_field
from smp_gym.registration import environment_id
from smp_gym.rollout import rollout
from smp_gym.sampling import sample_scene
from smp_planner.agents.acting import load_shipped
from smp_planner.agents.actor_file import read_actor
from smp_planner.agents.cloning import (
    Cloning,
    CloningSettings,
    DisturbedPolicy,
    Episode,
    demonstrated,
)
from smp_planner.policy.planner_policy import PlannerPolicy

FEW = CloningSettings(action_repeat=2, episodes=4, epochs=3, layers=(16,), apart=0.25, batch=64)


def _training(folder, settings=FEW, **changed):
    options = {"agent": "cloning", "task": "Placement", "difficulties": ["none"], "seed": 0}
    return Cloning(folder, settings=settings, **{**options, **changed})


@pytest.fixture(scope="module")
def placement_policy():
    return PlannerPolicy.make("smp", "Placement")


@pytest.fixture(scope="module")
def env():
    made = gymnasium.make(environment_id("Placement"))
    yield made
    made.close()


def test_without_bursts_the_policy_is_as_it_is(env, placement_policy):
    scene = sample_scene("Placement", "none", 79_006)
    plain = rollout(env, placement_policy, scene=scene)
    disturbed = DisturbedPolicy(placement_policy, FEW, np.random.default_rng(0))
    again = rollout(env, disturbed, scene=scene)
    assert (plain.steps, plain.reward) == (again.steps, again.reward)
    assert len(disturbed.labels) == plain.steps


def test_labels_lead_back_to_the_trajectory(env, placement_policy):
    """After a burst, the labels undo it: the reference comes back to where it would have been."""
    settings = CloningSettings(bursts=0.03, burst_steps=3)
    scene = sample_scene("Placement", "none", 79_006)

    def references(policy):
        seen = []
        rollout(
            env,
            policy,
            scene=scene,
            steps=60,
            recorders=[lambda m: seen.append(state_field(m.observation, "reference"))],
        )
        return np.array(seen)

    plain = references(placement_policy)
    off = references(
        DisturbedPolicy(placement_policy, settings, np.random.default_rng([79_006, 7]))
    )
    away = np.abs(plain - off).max(axis=1)
    assert away.max() > 0.02
    assert np.median(away) < 0.01
    episode = demonstrated(env, placement_policy, "none", 79_006, settings)
    assert episode is not None
    assert len(episode.actions) == len(episode.observations["observation"])
    assert np.abs(episode.actions).max() <= 1.0


def test_decisions_are_means_of_steps_in_which_nothing_pushes():
    """A ramp is its own mean in the middle of a decision, and at the end over what is left."""
    ramp = np.repeat(np.arange(8, dtype=np.float32)[:, None], 7, axis=1)
    disturbed = np.isin(np.arange(8), [3])
    found = Episode({"observation": ramp[:, :1]}, ramp, disturbed).decisions(3)
    np.testing.assert_array_equal(found.observations["observation"][:, 0], [0, 4, 5, 6, 7])
    np.testing.assert_allclose(found.actions, np.outer([1.0, 5.0, 6.0, 6.5, 7.0], np.ones(7)))


def test_rates_that_are_held_for_a_decision_succeed(env, placement_policy):
    """Arm and hand end where the planner leads them, in the physics."""
    repeat = 5
    scene = sample_scene("Placement", "none", 79_006)
    episode = demonstrated(env, placement_policy, "none", 79_006, CloningSettings())
    assert episode is not None
    actions = episode.decisions(repeat).actions

    class Held:
        def predict(self, observation, state=None, episode_start=None, deterministic=True):
            step = state or 0
            return actions[min(step, len(actions) - 1) // repeat * repeat], step + 1

    assert rollout(env, Held(), scene=scene).success


def test_random_rates_are_told_from_the_policys(env, placement_policy):
    """What the environment was given differs from the labels in the steps of bursts alone."""
    settings = CloningSettings(bursts=0.05, burst_steps=3)
    policy = DisturbedPolicy(placement_policy, settings, np.random.default_rng(3))
    done = []
    scene = sample_scene("Placement", "none", 79_006)
    rollout(env, policy, scene=scene, steps=60, recorders=[done.append])
    differ = [
        not np.array_equal(moment.action, label)
        for moment, label in zip(done[1:], policy.labels, strict=True)
    ]
    assert any(differ)
    assert differ == policy.disturbed


def test_a_training_goes_on_where_it_stopped(tmp_path):
    whole = _training(tmp_path / "whole")
    whole.watch()
    whole.fit()
    whole.close()
    parts = _training(tmp_path / "parts")
    parts.watch()

    class Stop(Exception):  # noqa: N818  (no error)
        pass

    def stop(epoch, error):
        if epoch == 2:
            raise Stop

    with pytest.raises(Stop):
        parts.fit(stop)
    parts.close()
    again = _training(tmp_path / "parts")
    assert again.epoch == 2
    again.watch()
    again.fit()
    again.close()
    assert [point[0] for point in again.curve] == [1, 2, 3]
    assert again.curve == whole.curve
    for name, value in whole.actor.state_dict().items():
        assert torch.equal(value, again.actor.state_dict()[name])
    actor, card = read_actor(tmp_path / "whole" / "agent.json")
    assert card.agent == "cloning"
    assert (card.action_repeat, actor.action_repeat) == (2, 2)
    assert card.training["settings"] == json.loads(FEW.model_dump_json())
    assert card.training["cpu_seconds"] > 0.0
    assert sum(p.numel() for p in actor.parameters()) == sum(
        p.numel() for p in whole.actor.parameters()
    )


def test_the_error_falls_and_the_least_one_is_kept(tmp_path):
    settings = CloningSettings(episodes=6, epochs=12, layers=(64,), apart=0.17, batch=128)
    training = _training(tmp_path, settings)
    training.watch()
    training.fit()
    training.close()
    apart = [held for _, _, held in training.curve]
    assert min(apart) < 0.75 * apart[0]
    _, card = read_actor(tmp_path / "agent.json")
    assert card.training["epochs"] == 1 + int(np.argmin(apart))


def test_folders_of_others_and_too_few_episodes_are_refused(tmp_path):
    training = _training(tmp_path / "a")
    with pytest.raises(FolderInUseError):
        _training(tmp_path / "a")
    training.close()
    with pytest.raises(ValueError, match="holds another training"):
        _training(tmp_path / "a", seed=1)
    with pytest.raises(ValueError, match="too few to learn from"):
        _training(tmp_path / "b").fit()


@pytest.mark.parametrize(
    "change",
    [
        {"action_repeat": 0},
        {"action_repeat": 2.5},
        {"bursts": 1.0},
        {"episodes": 1},
        {"apart": 0.0},
        {"learning_rate": float("nan")},
    ],
)
def test_settings_out_of_range_are_refused(change):
    with pytest.raises(ValueError, match=next(iter(change))):
        CloningSettings(**change)


def test_settings_are_those_of_all_and_of_the_agent(tmp_path):
    path = tmp_path / "settings.json"
    path.write_text('{"*": {"episodes": 7}, "distilled": {"bursts": 0.1}}')
    assert CloningSettings.from_json(path, "cloning") == CloningSettings(episodes=7)
    assert CloningSettings.from_json(path, "distilled").bursts == 0.1
    path.write_text("[]")
    with pytest.raises(ValueError, match="must hold settings by name"):
        CloningSettings.from_json(path, "cloning")


def test_an_agent_that_is_not_shipped_says_what_trains_it():
    with pytest.raises(ValueError, match=r"no agent cloning is shipped for .*train_cloning"):
        load_shipped("cloning", "DrawS")
