import json
import zipfile

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import SubprocVecEnv

import smp_gym  # noqa: F401
from smp_gym.datasets.demonstrations import Demonstrations
from smp_gym.env import SUCCESS_REWARD
from smp_gym.observation import MAX_EPISODE_STEPS
from smp_planner.planners import make_planner
from smp_planner.policy.planner_policy import PlannerPolicy

ID = "smp_gym/Placement-v0"


@pytest.fixture(scope="module")
def policy():
    return PlannerPolicy.make("smp", "Placement")


@pytest.fixture(scope="module")
def env():
    env = gym.make(ID)
    yield env
    env.close()


def first(env, seed):
    return env.reset(seed=seed)[0]


def counting(policy, monkeypatch):
    """Return a list that grows by the number of problems of each planning call."""
    calls = []
    plan = policy.planner.plan

    def counted(problems):
        if problems:
            calls.append(len(problems))
        return plan(problems)

    monkeypatch.setattr(policy.planner, "plan", counted)
    return calls


def play(policy, env, seed, deterministic=True):
    observation, info = env.reset(seed=seed)
    state, over = None, False
    while not over:
        action, state = policy.predict(observation, state, deterministic=deterministic)
        observation, _, terminated, truncated, info = env.step(action)
        over = terminated or truncated
    return info, state


def test_it_succeeds_in_the_physics_and_plans_once(policy, env, monkeypatch):
    calls = counting(policy, monkeypatch)
    for seed in range(4):
        info, state = play(policy, env, seed)
        assert info["is_success"], info
        assert state[0].particle == state[0].plan.chosen
    assert calls == [1] * 4


def test_single_batched_raw_and_flattened_observations_act_alike(policy, env, monkeypatch):
    rows = [first(env, seed) for seed in (0, 1)]
    flat = [spaces.flatten(policy.observation_space, row) for row in rows]
    alone = [policy.predict(row, deterministic=True) for row in rows]
    single = [action for action, _ in alone]
    batch = {key: np.stack([row[key] for row in rows]) for key in rows[0]}
    calls = counting(policy, monkeypatch)
    together, state = policy.predict(batch, deterministic=True)
    assert together.shape == (2, 7)
    np.testing.assert_array_equal(together, single)
    # Both are planned in one call, and the plans are those of each alone.
    assert calls == [2]
    assert len(state) == 2
    for mine, (_, (other,)) in zip(state, alone, strict=True):
        np.testing.assert_array_equal(mine.plan.trajectories, other.plan.trajectories)
        np.testing.assert_array_equal(mine.plan.ranks, other.plan.ranks)
    np.testing.assert_array_equal(policy.predict(np.stack(flat), deterministic=True)[0], single)
    np.testing.assert_array_equal(policy.predict(flat[1], deterministic=True)[0], single[1])
    assert policy.action_space.contains(single[0])


@pytest.fixture(scope="module")
def conditioned():
    """A planner that is quick, and the demonstrations that it has learned from."""
    demonstrations = Demonstrations.load("Placement")
    settings = {"particles": 2, "samples": 200}
    return make_planner("promp", "Placement", settings=settings), demonstrations


def test_episodes_that_begin_together_are_planned_on_a_device(conditioned, env):
    planner, demonstrations = conditioned
    policy = PlannerPolicy(planner, demonstrations, device="cpu")
    rows = [first(env, seed) for seed in (0, 1)]
    batch = {key: np.stack([row[key] for row in rows]) for key in rows[0]}
    _, state = policy.predict(batch, deterministic=True)
    for execution, row in zip(state, rows, strict=True):
        (alone,) = planner.plan([policy.problem(row)])
        mine = execution.plan
        np.testing.assert_allclose(mine.trajectories, alone.trajectories, atol=1e-9)
        np.testing.assert_array_equal(mine.good, alone.good)
        # A device checks in single precision, which tells that it was one.
        assert (mine.clearance == mine.clearance.astype(np.float32)).all()
        assert (alone.clearance != alone.clearance.astype(np.float32)).any()


def test_plans_keep_a_deadline(conditioned, env):
    """No time is left to check more than one particle of each episode."""
    planner, demonstrations = conditioned
    policy = PlannerPolicy(planner, demonstrations, deadline=1e-6)
    plan = policy.plan(first(env, 0))
    assert plan.solved or "of the 1 that were checked before the deadline" in plan.message


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"deadline": 0.0}, r"deadline must be a positive number of seconds, got 0\.0"),
        ({"deadline": -1}, "deadline must be a positive number of seconds, got -1"),
        ({"deadline": float("nan")}, "deadline must be a positive number of seconds, got nan"),
        ({"deadline": "soon"}, "deadline must be a positive number of seconds, got 'soon'"),
        ({"device": "cuda:99"}, "device must be one of 'cpu'.*got 'cuda:99'"),
        ({"device": "gpu"}, "device must be 'cpu' or 'cuda', got 'gpu'"),
        ({"device": "cpu", "deadline": 1.0}, r"deadline must be None on a device, got 1\.0"),
    ],
)
def test_bad_devices_and_deadlines_are_refused(conditioned, options, message):
    with pytest.raises(ValueError, match=message):
        PlannerPolicy(*conditioned, **options)


@pytest.mark.parametrize("option", [{"device": "cpu"}, {"deadline": 1.0}])
def test_a_planner_that_takes_neither_device_nor_deadline_is_named(option):
    with pytest.raises(ValueError, match=r"must be None for RRTConnectPlanner, whose plan"):
        PlannerPolicy.make("rrt_connect", "Placement", **option)


def test_stochastic_acting_draws_a_good_particle(policy, env):
    observation = first(env, 2)
    _, state = policy.predict(observation, deterministic=False)
    assert state[0].plan.good[state[0].particle]
    _, again = policy.predict(observation, deterministic=False)
    assert again[0].particle == state[0].particle
    particles = set()
    for seed in range(4):
        policy.set_random_seed(seed)
        particles.add(policy.predict(observation, deterministic=False)[1][0].particle)
    policy.set_random_seed(0)
    assert len(particles) > 1


def test_stochastic_episodes_succeed_too(policy, env):
    assert play(policy, env, 1, deterministic=False)[0]["is_success"]


def test_a_lost_state_means_a_new_plan_from_where_the_arm_is(policy, env):
    observation = first(env, 0)
    state = None
    for _ in range(20):
        action, state = policy.predict(observation, state, deterministic=True)
        observation = env.step(action)[0]
    _, fresh = policy.predict(observation, None, deterministic=True)
    begins = fresh[0].plan.trajectories[fresh[0].plan.chosen, 0]
    np.testing.assert_allclose(begins, observation["observation"][6:12], atol=1e-6)
    assert fresh[0].track.first_step == 20


def test_evaluate_policy_plans_once_per_episode(policy, monkeypatch):
    calls = counting(policy, monkeypatch)
    venv = SubprocVecEnv([make_env] * 2)
    venv.seed(11)
    try:
        rewards, lengths = evaluate_policy(
            policy, venv, n_eval_episodes=3, return_episode_rewards=True, warn=False
        )
    finally:
        venv.close()
    assert rewards == [SUCCESS_REWARD] * 3
    assert 1 < min(lengths) <= max(lengths) < MAX_EPISODE_STEPS
    # 3 episodes are counted. An environment that has played its share goes on, and is planned
    # for: at most one more episode each.
    assert 3 <= sum(calls) <= 5


def make_env():
    from stable_baselines3.common.monitor import Monitor

    return Monitor(gym.make("smp_gym:smp_gym/Placement-v0", difficulty="easy", family="clutter"))


def test_saving_and_loading_give_back_the_policy(policy, env, tmp_path):
    custom = PlannerPolicy.make("smp", "Placement", settings={"particles": 8}, seed=5)
    path = tmp_path / "policy.zip"
    custom.save(path)
    loaded = PlannerPolicy.load(path)
    assert loaded.seed == 5
    assert loaded.planner.settings == custom.planner.settings
    observation = first(env, 4)
    mine, theirs = (p.predict(observation, deterministic=True) for p in (custom, loaded))
    np.testing.assert_array_equal(mine[0], theirs[0])
    np.testing.assert_array_equal(mine[1][0].plan.trajectories, theirs[1][0].plan.trajectories)


def test_a_failed_save_leaves_the_old_file(policy, tmp_path, monkeypatch):
    path = tmp_path / "policy.zip"
    policy.save(path)
    before = path.read_bytes()
    monkeypatch.setattr(json, "dumps", lambda *_, **__: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        policy.save(path)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_damaged_files_are_refused(policy, tmp_path):
    path = tmp_path / "policy.zip"
    policy.save(path)
    content = path.read_bytes()
    for damaged in (b"", b"hello", content[: len(content) // 2]):
        path.write_bytes(damaged)
        with pytest.raises(ValueError, match=r"policy\.zip"):
            PlannerPolicy.load(path)
    with pytest.raises(FileNotFoundError):
        PlannerPolicy.load(tmp_path / "nowhere.zip")


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"version": 99}, "99"),
        ({"format": "other"}, "other"),
        ({"method": "teleport"}, "teleport"),
        ({"settings": {"colour": 1}}, "colour"),
    ],
)
def test_files_of_another_kind_are_refused(policy, tmp_path, change, named):
    path = tmp_path / "policy.zip"
    policy.save(path)
    with zipfile.ZipFile(path) as archive:
        entries = {name: archive.read(name) for name in archive.namelist()}
    entries["policy.json"] = json.dumps(json.loads(entries["policy.json"]) | change).encode()
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in entries.items():
            archive.writestr(name, content)
    with pytest.raises(ValueError, match=named):
        PlannerPolicy.load(path)


@pytest.mark.parametrize("seed", [-1, 1.5, "seven"])
def test_bad_seeds_are_refused(policy, seed):
    with pytest.raises(ValueError, match="seed"):
        policy.set_random_seed(seed)


def test_foreign_observations_and_states_are_refused(policy, env):
    cart = gym.make("CartPole-v1")
    with pytest.raises(ValueError, match="observation"):
        policy.predict(cart.reset(seed=0)[0])
    with pytest.raises(ValueError, match="keys"):
        policy.predict({"observation": np.zeros(4)})
    _, state = policy.predict(first(env, 0), deterministic=True)
    with pytest.raises(ValueError, match="state"):
        policy.predict(first(env, 0), state * 2)


def test_an_environment_that_takes_other_actions_is_refused(policy, env):
    hand = gym.make(ID, control="end_effector")
    observation = first(hand, 0)
    hand.close()
    for given in (observation, spaces.flatten(policy.observation_space, observation)):
        with pytest.raises(ValueError, match=r"'end_effector'.*control='joint_velocity'"):
            policy.predict(given)
    mixed = {key: np.stack([first(env, 0)[key], observation[key]]) for key in observation}
    with pytest.raises(ValueError, match="'end_effector'"):
        policy.predict(mixed)


def test_the_problem_and_the_track_are_those_that_are_acted_on():
    policy = PlannerPolicy.make("promp", "Placement")
    env = gym.make("smp_gym/Placement-v0")
    observation, _ = env.reset(seed=3)
    env.close()
    action, (execution,) = policy.predict(observation, deterministic=True)
    (plan,) = policy.planner.plan([policy.problem(observation)])
    np.testing.assert_array_equal(plan.trajectories, execution.plan.trajectories)
    reference = np.asarray(observation["observation"][6:12], np.float64)
    np.testing.assert_array_equal(policy.track(plan, plan.chosen).action(0, reference), action)
    batch = {key: value[None] for key, value in observation.items()}
    with pytest.raises(ValueError, match="batch of 1"):
        policy.problem(batch)
