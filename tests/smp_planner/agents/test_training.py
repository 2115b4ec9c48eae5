"""Training of agents, on short trainings and episodes whose outcome is known."""

import json
import runpy
from itertools import count, pairwise
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch
import typer
from gymnasium.wrappers import FilterObservation
from killed import MID_WRITE, killed
from stable_baselines3 import SAC, HerReplayBuffer
from stable_baselines3.common.env_util import make_vec_env
from typer.testing import CliRunner, Result

from smp_gym.assets import asset_path
from smp_gym.env import FAILURE_REWARD, SUBGOAL_REWARD, SUCCESS_REWARD
from smp_gym.folder_lock import FolderLock
from smp_gym.observation import MAX_EPISODE_STEPS
from smp_gym.registration import environment_id
from smp_gym.rollout import Moment, rollout
from smp_gym.scene import TASKS
from smp_planner.agents.actor_file import read_actor
from smp_planner.agents.checkpoints import load_checkpoint, save_checkpoint
from smp_planner.agents.decisions import ACTION_REPEAT, acting
from smp_planner.agents.evaluations import evaluate, read_evaluations
from smp_planner.agents.hyper_parameters import LEARNERS, HyperParameters
from smp_planner.agents.learners import make_model
from smp_planner.agents.shipping import ship_agent

SCRIPT = Path(__file__).parents[3] / "scripts" / "train_agent.py"
ID = "smp_gym/Placement-v0"
TINY: dict[str, Any] = {
    "environments": 1,
    "observations": ["observation", "achieved_goal", "desired_goal"],
    "hidden": ["released"],
    "action_repeat": 1,
    "gripper_openings": {"probability": 0.1, "decisions": 3},
    "arguments": {
        "learning_starts": MAX_EPISODE_STEPS,
        "batch_size": 32,
        "buffer_size": 1000,
        "policy_kwargs": {"net_arch": [16]},
    },
    "her": {"n_sampled_goal": 4, "goal_selection_strategy": "future"},
}


def _seen(env: gym.Env[Any, Any]) -> gym.Env[Any, Any]:
    return FilterObservation(env, TINY["observations"])


def _write(path: Path, settings: Any) -> Path:
    path.write_text(json.dumps({"*": settings}))
    return path


def _train(*arguments: str) -> Result:
    app = typer.Typer()
    app.command()(runpy.run_path(str(SCRIPT))["main"])
    return CliRunner().invoke(app, arguments, env={"COLUMNS": "500"})


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder in which a training was ended early and then gone on with."""
    folder = tmp_path_factory.mktemp("agent")
    settings = _write(folder / "settings.json", TINY)
    for out, steps, every in (
        ("out", "450", "300"),
        ("out", "500", "300"),
        ("at_once", "500", "500"),
    ):
        result = _train(
            "--settings", str(settings), "--out", str(folder / out), "--steps", steps,
            "--every", every, "--episodes", "1", "--final-episodes", "1",
        )  # fmt: skip
        assert result.exit_code == 0, result.output
        assert ("going on from step 450" in result.output) == ((out, steps) == ("out", "500"))
    return folder


def test_training_learns_from_hindsight_and_goes_on(trained: Path) -> None:
    evaluations = read_evaluations(trained / "out" / "evaluations.csv")
    assert [e.steps for e in evaluations] == [300, 450, 500]
    env = make_vec_env(ID, env_kwargs={"difficulty": "none"}, wrapper_class=_seen)
    model = load_checkpoint(trained / "out", env, SAC)
    assert model.num_timesteps == 500
    # One gradient step for each step after `learning_starts`.
    assert model._n_updates == 500 - MAX_EPISODE_STEPS
    assert model.replay_buffer.size() == 500
    settings = HyperParameters(**TINY)
    untrained = make_model(env, "Placement", settings, seed=0).get_parameters()["policy"]
    change = [
        float((model.get_parameters()["policy"][name] - value).abs().max())
        for name, value in untrained.items()
        if name.startswith("actor.")
    ]
    assert min(change) > 0.0
    env.close()


def test_an_interrupted_training_is_equal_to_one_at_once(trained: Path) -> None:
    env = make_vec_env(ID, env_kwargs={"difficulty": "none"}, wrapper_class=_seen)
    interrupted, at_once = (load_checkpoint(trained / out, env, SAC) for out in ("out", "at_once"))
    for name, value in at_once.policy.state_dict().items():
        assert torch.equal(value, interrupted.policy.state_dict()[name]), name
    for part in ("actions", "rewards", "timeouts"):
        ours, theirs = (getattr(m.replay_buffer, part) for m in (interrupted, at_once))
        assert np.array_equal(ours, theirs), part
    assert interrupted._last_obs.keys() == at_once._last_obs.keys()
    for name, value in at_once._last_obs.items():
        assert np.array_equal(value, interrupted._last_obs[name])
    env.close()


def test_two_trainings_in_one_folder_lock_each_other_out(trained: Path) -> None:
    before = {path.name: path.read_bytes() for path in (trained / "at_once").glob("*.*")}
    with FolderLock(trained / "at_once"):
        settings = str(trained / "settings.json")
        result = _train("--settings", settings, "--out", str(trained / "at_once"))
    assert result.exit_code == 2
    assert "another process is writing to the folder" in result.output
    assert {path.name: path.read_bytes() for path in (trained / "at_once").glob("*.*")} == before


def test_a_kill_within_a_checkpoint_leaves_the_old_or_the_new(trained: Path) -> None:
    env = make_vec_env(ID, env_kwargs={"difficulty": "none"}, wrapper_class=_seen)
    model = load_checkpoint(trained / "at_once", env, SAC)

    def save() -> None:
        model.num_timesteps = 700
        save_checkpoint(model, trained / "at_once")

    assert killed(save, MID_WRITE)
    steps = []
    for moment in count(1):
        ended = killed(save, moment)
        newest = max((trained / "at_once").glob("checkpoint-*"), key=lambda path: path.name)
        steps.append(SAC.load(newest / "model.zip", env=env, device="cpu").num_timesteps)
        if not ended:
            break
    assert steps == sorted(steps)
    assert set(steps) == {500, 700}
    # Nothing is left of what the killed ones had begun.
    assert len(list((trained / "at_once").glob("*checkpoint*"))) == 1
    env.close()


def test_the_agent_acts_without_environment_or_replay_buffer(trained: Path) -> None:
    model = SAC.load(trained / "out" / "agent.zip", device="cpu")
    env = _seen(gym.make(ID, difficulty="none"))
    observation, _ = env.reset(seed=0)
    action, _ = model.predict(observation, deterministic=True)
    assert env.action_space.contains(action)
    env.close()


def test_result_and_figure_are_written(trained: Path) -> None:
    result = json.loads((trained / "out" / "result.json").read_text())
    assert {name: entry["episodes"] for name, entry in result.items()} == {"final": 1, "best": 1}
    final = SAC.load(trained / "out" / "final.zip", device="cpu")
    assert final.num_timesteps == result["final"]["steps"] == 500
    assert (trained / "out" / "learning_curve.png").read_bytes().startswith(b"\x89PNG")


def test_a_shipped_actor_acts_as_the_agent_did(trained: Path, tmp_path: Path) -> None:
    """Without stable-baselines3: from its card and fp16 weights alone."""
    path = ship_agent(trained / "out", folder=tmp_path)
    actor, card = read_actor(path)
    assert (card.agent, card.task, card.training["steps"]) == ("sac_her", "Placement", 500)
    assert card.training["cpu_seconds"] > 0.0
    agent = SAC.load(trained / "out" / "final.zip", device="cpu")
    env = gym.make(ID, difficulty="none")
    moments: list[Moment] = []
    rollout(env, acting(actor), seed=5, steps=60, recorders=[moments.append])
    env.close()
    for before, after in pairwise(moments):
        seen = {key: before.observation[key] for key in TINY["observations"]}
        theirs, _ = agent.predict(seen, deterministic=True)
        np.testing.assert_allclose(after.action, theirs, atol=2e-3)


def test_a_damaged_actor_is_refused(trained: Path, tmp_path: Path) -> None:
    path = ship_agent(trained / "out", folder=tmp_path)
    content = json.loads(path.read_text())
    for change, named in (
        ({"version": 99}, "must be the card of an agent"),
        ({"layers": [8]}, "is not the weights of"),
        ({"hidden": ["colour"]}, "names no network: hidden must name"),
        ({"entries": ["observation"]}, "names no network: entries must be"),
        ({"task": "Juggle"}, "names no network"),
        ({"layers": "wide"}, "names no network"),
    ):
        path.write_text(json.dumps({**content, **change}))
        with pytest.raises(ValueError, match=named):
            read_actor(path)
    with pytest.raises(ValueError, match="must hold a finished training"):
        ship_agent(tmp_path, folder=tmp_path)


def test_hindsight_rewards_are_those_of_the_environment() -> None:
    env = make_vec_env(ID, env_kwargs={"difficulty": "none"}, seed=0)
    model = SAC(
        "MultiInputPolicy",
        env,
        replay_buffer_class=HerReplayBuffer,
        replay_buffer_kwargs={"n_sampled_goal": 4, "goal_selection_strategy": "future"},
        learning_starts=1000,
        buffer_size=1000,
        policy_kwargs={"net_arch": [8]},
        seed=0,
        device="cpu",
    )
    model.learn(900)
    assert model.replay_buffer is not None
    batch: Any = model.replay_buffer.sample(512)
    achieved = batch.next_observations["achieved_goal"].numpy()
    desired = batch.next_observations["desired_goal"].numpy()
    near = (np.abs(achieved - desired)[:, :3] <= (0.08, 0.08, 0.05)).all(axis=1)
    flags = (achieved[:, 4:] >= desired[:, 4:]).all(axis=1)
    collided, released, at_rest, supported = achieved[:, 3:].T > 0.5
    success = near & flags & ~collided & (supported | ~released)
    lost = released & at_rest & ~success
    rewards = batch.rewards.numpy()[:, 0]
    partial = success & (desired[:, 4] < 0.5)
    assert partial.any()
    assert (rewards[partial] == SUBGOAL_REWARD).all()
    assert (rewards[success & ~partial] == SUCCESS_REWARD).all()
    for outcome in (success, collided, lost, ~success & ~collided & ~lost):
        assert outcome.any()
    assert (rewards[collided | lost] == FAILURE_REWARD).all()
    assert (rewards[~success & ~collided & ~lost] == 0.0).all()
    env.close()


class _Known(gym.Env[np.ndarray, np.ndarray]):
    """Succeeds at even seeds, collides at odd ones, after as many steps as the seed says."""

    observation_space = gym.spaces.Box(-1.0, 1.0, (1,))
    action_space = gym.spaces.Box(-1.0, 1.0, (1,))

    def reset(self, *, seed: Any = None, options: Any = None) -> Any:
        self.seed, self.left = seed, seed
        return np.zeros(1, np.float32), {}

    def step(self, action: Any) -> Any:
        self.left -= 1
        odd = self.seed % 2 == 1
        info = {"is_success": not odd, "collided": odd}
        return np.zeros(1, np.float32), -1.0, self.left <= 0, False, info


def test_evaluation_counts() -> None:
    env = _Known()
    evaluation = evaluate(SAC("MlpPolicy", env, device="cpu"), env, range(1, 6))
    assert (evaluation.successes, evaluation.collisions, evaluation.episodes) == (2, 3, 5)
    assert evaluation.mean_steps == 3.0
    # Wilson's interval by its formula.
    z, n, p = 1.959964, 5, 0.4
    centre = (p + z**2 / (2 * n)) / (1 + z**2 / n)
    half = z / (1 + z**2 / n) * np.sqrt(p * (1 - p) / n + z**2 / (4 * n**2))
    assert (evaluation.low, evaluation.high) == pytest.approx((centre - half, centre + half))


@pytest.mark.parametrize("agent", LEARNERS)
@pytest.mark.parametrize("task", TASKS)
def test_the_shipped_hyper_parameters_are_accepted(agent: str, task: str) -> None:
    path = asset_path("agents", "learner_settings.json")
    settings = HyperParameters.from_json(path, agent, task)
    assert settings.reward == ("dense" if agent in ("sac_dense", "ppo") else "sparse")
    small = {} if agent == "ppo" else {"buffer_size": 1000}
    settings = settings.model_copy(update={"arguments": settings.arguments | small})
    env = make_vec_env(environment_id(task, settings.reward), env_kwargs={"difficulty": "none"})
    model = make_model(env, task, settings, seed=0)
    observation = env.reset()
    action, _ = model.predict(observation)
    env.step(action)
    assert vars(model)[ACTION_REPEAT] == settings.action_repeat
    env.close()


def test_obstacles_are_seen_where_there_are_any() -> None:
    settings = HyperParameters()
    assert set(settings.seen("none")) == {"observation", "achieved_goal", "desired_goal"}
    assert set(settings.seen("easy")) == {*settings.seen("none"), "obstacles"}
    chosen = HyperParameters(observations=TINY["observations"])
    assert chosen.seen("easy") == tuple(TINY["observations"])


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (("--task", "Juggle"), "Placement"),
        (("--difficulty", "brutal"), "medium"),
        (("--agent", "dqn"), "sac_demonstrations"),
        (("--steps", "0"), "--steps"),
        (("--episodes", "0"), "--episodes"),
        (("--threads", "3"), "--threads"),
        (("--settings", "/nowhere.json"), "/nowhere.json"),
    ],
)
def test_bad_arguments_are_named(tmp_path: Path, arguments: tuple[str, ...], named: str) -> None:
    result = _train("--out", str(tmp_path / "out"), *arguments)
    assert result.exit_code == 2
    assert named in result.output
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("settings", "named"),
    [
        ([], "settings for '\\*', got \\[\\]"),
        ({**TINY, "colour": "red"}, "colour"),
        ({**TINY, "algorithm": "DQN"}, "algorithm"),
        ({**TINY, "reward": "rich"}, "reward"),
        ({**TINY, "observations": ["picture"]}, "observations(.|\n)*got \\['picture'\\]"),
        ({**TINY, "observations": []}, "observations(.|\n)*must be"),
        ({**TINY, "observations": ["observation"]}, "with observation, achieved_goal"),
        ({**TINY, "environments": 0}, "environments"),
        ({**TINY, "action_repeat": 0}, "action_repeat"),
        ({**TINY, "action_repeat": 2.5}, "action_repeat"),
        ({**TINY, "action_repeat": True}, "action_repeat must be a number"),
        ({**TINY, "gripper_openings": {"probability": 0.1}}, "gripper_openings.decisions"),
        ({**TINY, "gripper_openings": {"probability": 1.5, "decisions": 3}}, "probability"),
        ({**TINY, "gripper_openings": {"probability": 0.5, "decisions": 0}}, "decisions"),
        ({**TINY, "arguments": {"learning_starts": 10}}, "learning_starts"),
        ({**TINY, "arguments": {"learning_rate": 0}}, "learning_rate must be positive"),
        ({**TINY, "arguments": {"learning_rate": {"start": 1}}}, "got {'start': 1}"),
        (
            {**TINY, "action_repeat": 5, "arguments": {"learning_starts": 79}},
            "learning_starts must be at least 80",
        ),
        ({**TINY, "demonstrations": {}}, "demonstrations must be null where her is not"),
        ({**TINY, "her": None, "demonstrations": {"share": 1.0}}, "demonstrations.share"),
        ({**TINY, "her": None, "demonstrations": {}}, "ent_coef must be a number.*got 'auto'"),
        (
            {**TINY, "her": None, "demonstrations": {}, "reward": "dense"},
            "reward must be sparse with demonstrations",
        ),
        ({**TINY, "algorithm": "PPO"}, "gripper_openings must be null but for SAC"),
    ],
)
def test_bad_settings_are_named(tmp_path: Path, settings: Any, named: str) -> None:
    with pytest.raises(ValueError, match=named):
        HyperParameters.from_json(
            _write(tmp_path / "settings.json", settings), "sac_her", "Placement"
        )


def test_settings_that_are_not_json(tmp_path: Path) -> None:
    path = tmp_path / "settings.json"
    path.write_text("learning_rate: 1")
    with pytest.raises(ValueError, match=r"settings.json"):
        HyperParameters.from_json(path, "sac_her", "Placement")


def test_refused_settings_claim_no_folder(tmp_path: Path) -> None:
    wrong = _write(
        tmp_path / "wrong.json", {**TINY, "arguments": {**TINY["arguments"], "learning_pace": 1.0}}
    )
    result = _train("--settings", str(wrong), "--out", str(tmp_path / "out"))
    assert result.exit_code == 2
    assert "learning_pace" in result.output
    assert not (tmp_path / "out").exists()


def test_unknown_arguments_of_sac_are_named() -> None:
    env = make_vec_env(ID, env_kwargs={"difficulty": "none"})
    tiny = HyperParameters(**TINY)
    settings = tiny.model_copy(update={"arguments": {"learning_pace": 1.0}})
    with pytest.raises(ValueError, match="learning_pace"):
        make_model(env, "Placement", settings, seed=0)
    settings = tiny.model_copy(update={"hidden": ("colour",)})
    with pytest.raises(ValueError, match=r"hidden must name goal fields of Placement, .*'colour'"):
        make_model(env, "Placement", settings, seed=0)
    env.close()


def test_a_folder_of_another_training_is_left_alone(trained: Path) -> None:
    before = (trained / "out" / "run.json").read_text()
    result = _train(
        "--settings", str(trained / "settings.json"), "--out", str(trained / "out"),
        "--seed", "1",
    )  # fmt: skip
    assert result.exit_code == 2
    assert "another training" in result.output
    assert (trained / "out" / "run.json").read_text() == before
