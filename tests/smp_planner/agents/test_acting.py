"""Agents as methods of the benchmark: stable-baselines3's zips and random actions, end to end."""

import importlib
import sys
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.wrappers import FilterObservation
from stable_baselines3 import PPO, SAC

import smp_gym  # noqa: F401  (registers the environments)
from smp_gym.observation import observation_space
from smp_gym.registration import environment_id
from smp_gym.rollout import rollout
from smp_gym.suites import Cell
from smp_planner.agents.acting import RandomActions, load_zip
from smp_planner.benchmark.manifest import EpisodeStore, make_manifest, read_results
from smp_planner.benchmark.methods import resolve_method
from smp_planner.benchmark.results_folder import ResultsError
from smp_planner.benchmark.summary import summarise

NONE = Cell("Placement", "none")
KEYS = ["desired_goal", "observation"]


def small():
    return {"policy_kwargs": {"net_arch": [8]}, "device": "cpu", "seed": 0}


class Bare(gym.Env):
    """Has the spaces of an environment, and nothing else: enough to make an agent for it."""

    def __init__(self, seen, actions=None):
        self.observation_space = seen
        self.action_space = actions or spaces.Box(-1.0, 1.0, (7,), np.float32)


@pytest.fixture(scope="module")
def env():
    made = gym.make(environment_id("Placement"), difficulty="none", max_episode_steps=8)
    yield made
    made.close()


@pytest.fixture(scope="module")
def sac(tmp_path_factory) -> Path:
    """Return the zip of an untrained agent that sees two of the entries."""
    path = tmp_path_factory.mktemp("agents") / "sac.zip"
    seen = observation_space("Placement")
    model = SAC("MultiInputPolicy", Bare(spaces.Dict({k: seen[k] for k in KEYS})), **small())
    model.save(path)
    return path


def test_a_zip_acts_as_the_agent_in_its_own_wrapper(env, sac):
    agent = load_zip(sac, "sac")
    agent.check("Placement", "exact")
    original = SAC.load(sac, device="cpu")
    seen = []
    rollout(env, agent, seed=3, recorders=[seen.append])
    theirs = []
    rollout(FilterObservation(env, KEYS), original, seed=3, recorders=[theirs.append])
    assert len(seen) == len(theirs) == 9
    for mine, other in zip(seen[1:], theirs[1:], strict=True):
        np.testing.assert_array_equal(mine.action, other.action)
    assert np.abs([moment.action for moment in seen[1:]]).max() > 0.0


def test_an_agent_of_flat_observations_sees_them_as_gymnasium_flattens_them(env, tmp_path):
    space = observation_space("Placement")
    flat = spaces.flatten_space(space)
    model = PPO("MlpPolicy", Bare(flat), **small())
    model.save(tmp_path / "ppo.zip")
    agent = load_zip(tmp_path / "ppo.zip", "ppo")
    agent.check("Placement", "exact")
    observation, _ = env.reset(seed=4)
    expected, _ = model.predict(spaces.flatten(space, observation), deterministic=True)
    np.testing.assert_array_equal(agent.predict(observation, deterministic=True)[0], expected)
    with pytest.raises(ValueError, match="'ppo' was trained on observations Box"):
        agent.check("DrawS", "exact")


def test_a_policy_of_ones_own_is_one_of_its_algorithm(sac, tmp_path, monkeypatch):
    """Told by the class that it derives from, wherever it lies."""
    (tmp_path / "my_policies.py").write_text(
        "from stable_baselines3.sac.policies import MultiInputPolicy\n"
        "class Mine(MultiInputPolicy):\n    pass\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    policy = importlib.import_module("my_policies").Mine
    seen = SAC.load(sac, device="cpu").observation_space
    model = SAC(policy, Bare(seen), **small())
    model.save(tmp_path / "mine.zip")
    assert type(load_zip(tmp_path / "mine.zip", "mine").agent.policy).__name__ == "Mine"
    monkeypatch.delitem(sys.modules, "my_policies")
    (tmp_path / "my_policies.py").unlink()
    importlib.invalidate_caches()
    with pytest.raises(ValueError, match=r"policy of the module my_policies, which cannot be"):
        load_zip(tmp_path / "mine.zip", "mine")


def test_random_actions_are_those_of_the_episode(env):
    played = [[], [], []]
    for moments, seed in zip(played, (5, 5, 6), strict=True):
        rollout(env, RandomActions(), seed=seed, recorders=[moments.append])
    first, again, other = (np.array([m.action for m in moments[1:]]) for moments in played)
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - other).max() > 0.1
    assert first.min() >= -1.0
    assert first.max() <= 1.0
    assert first.std() == pytest.approx(1.0 / np.sqrt(3.0), abs=0.15)


def test_agents_are_measured_as_planners_are_and_a_changed_zip_is_not_mixed(sac, tmp_path):
    path = tmp_path / "mine.zip"
    path.write_bytes(sac.read_bytes())
    methods = ["random", f"mine={path}"]
    manifest = make_manifest([NONE], methods, 0, 1)
    assert manifest.methods == ("random", "mine")
    out = tmp_path / "out"
    with EpisodeStore(out, manifest) as store:
        for key in manifest.episode_keys():
            store.append(manifest.player(key))
    rows = read_results(out)[1]
    assert sorted(row.method for row in rows) == ["mine", "random"]
    for row in rows:
        assert row.share_good is None
        assert row.chosen_duration is None
        assert row.planning_time == 0.0
        assert 1 <= row.steps <= 400
        assert not row.success
        assert row.goal_error > 0.05
    group = summarise(manifest, rows)["groups"][0]
    assert group["success"]["value"] == 0.0
    assert group["share_good"] is None
    model = SAC.load(path, device="cpu")
    model.policy.actor.mu.bias.data += 1.0
    model.save(path)
    with pytest.raises(ResultsError, match="method_code of mine"):
        EpisodeStore(out, make_manifest([NONE], methods, 0, 2))


def test_a_space_that_does_not_fit_is_refused_before_anything_runs(sac):
    with pytest.raises(ValueError, match=r"'a'.*DrawS.*'desired_goal' of shape"):
        make_manifest([Cell("DrawS", "easy")], [f"a={sac}"], 0, 1)
    seen = observation_space("Placement")
    with_rows = spaces.Dict({"obstacles": seen["obstacles"]})
    agent = load_zip(sac, "rows")
    agent = type(agent)(agent.agent, with_rows, "rows")
    with pytest.raises(ValueError, match=r"sensing 'depth'.*no entry 'obstacles'.*points"):
        agent.check("Placement", "depth")


def test_other_actions_are_refused(tmp_path):
    few = spaces.Box(-1.0, 1.0, (3,), np.float32)
    SAC("MlpPolicy", Bare(spaces.Box(-1.0, 1.0, (4,)), few), **small()).save(tmp_path / "few.zip")
    with pytest.raises(ValueError, match=r"'few' must act in Box.*\(7,\)"):
        load_zip(tmp_path / "few.zip", "few")


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("a={}/none.zip", r"agent 'a': no file .*none\.zip"),
        ("random={}/text.zip", "name 'random' of a method is taken"),
        ("smp={}/text.zip", "name 'smp' of a method is taken"),
        ("a b={}/text.zip", "letters, digits"),
        ("a={}/text.zip", "must be an agent that stable-baselines3 saved"),
    ],
)
def test_what_is_no_agent_is_refused(tmp_path, spec, message):
    (tmp_path / "text.zip").write_text("no zip")
    with pytest.raises(ValueError, match=message):
        make_manifest([NONE], [spec.format(tmp_path)], 0, 1)


def test_an_agent_makes_no_plans_anew():
    with pytest.raises(ValueError, match=r"can go on from a plan.*agent 'random'"):
        make_manifest([NONE], ["random"], 0, 1, replan_every=5)


@pytest.mark.parametrize("agent", ["sac_her", "sac_demonstrations"])
def test_a_shipped_agent_places_and_says_where_it_cannot(agent):
    """On tuning seeds that it was neither trained nor chosen on."""
    method = resolve_method(agent)
    assert not method.plans
    policy = method.policy("Placement")
    with gym.make("smp_gym/Placement-v0", difficulty="none") as env:
        assert [rollout(env, policy, seed=seed).success for seed in range(74300, 74304)] == [
            True
        ] * 4
    with pytest.raises(ValueError, match=rf"no agent {agent} is shipped for DrawS .*train_agent"):
        method.policy("DrawS")
