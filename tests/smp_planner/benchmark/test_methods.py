"""Agents of one's own as methods: a class with `predict`, in a file of the user's."""

import importlib
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

from smp_gym.rollout import Moment, rollout
from smp_gym.suites import Cell
from smp_planner.benchmark.episodes import EpisodeKey, play_episode
from smp_planner.benchmark.methods import resolve_method
from smp_planner.planners import bump_planner

AGENT = '''
import numpy as np

class Waving:
    """Turns the first joint to and fro, and counts its steps in the state."""
    def __init__(self, task):
        self.task = task
    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        step = state or 0
        action = np.zeros(7, np.float32)
        action[0] = 0.2 if step % 20 < 10 else -0.2
        return action, step + 1

class Many:
    def __init__(self, task, layers):
        pass
    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        raise NotImplementedError

class Neither:
    pass

number = 3
'''


@pytest.fixture
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    monkeypatch.syspath_prepend(tmp_path)
    path = tmp_path / "waving_agent.py"
    path.write_text(AGENT)
    importlib.invalidate_caches()
    yield path
    sys.modules.pop("waving_agent", None)


@pytest.fixture(scope="module")
def env() -> Iterator[gymnasium.Env[Any, Any]]:
    made = gymnasium.make("smp_gym/DrawS-v0", difficulty="none", max_episode_steps=20)
    yield made
    made.close()


def test_a_class_that_predicts_is_played_as_a_method(
    module: Path, env: gymnasium.Env[Any, Any]
) -> None:
    method = resolve_method("waving=waving_agent:Waving")
    assert (method.name, method.plans) == ("waving", False)
    policy = method.policy("DrawS")
    moments: list[Moment] = []
    played = rollout(env, policy, seed=3, recorders=(moments.append,))
    turned = np.array([moment.observation["observation"][0] for moment in moments])
    # 10 steps out at a fifth of 0.628 rad/s for 0.05 s each, and 10 back.
    assert (played.success, played.state) == (False, 20)
    assert np.ptp(turned) == pytest.approx(10 * 0.2 * 0.628 * 0.05, rel=0.1)
    assert turned[-1] == pytest.approx(turned[0], abs=0.01)


def test_rows_of_an_agent_have_no_particles(module: Path, env: gymnasium.Env[Any, Any]) -> None:
    method = resolve_method("waving=waving_agent:Waving")
    key = EpisodeKey("DrawS", method.name, "none", 3)
    row = play_episode(key, env, method.policy("DrawS")).row
    assert (row.method, row.success, row.planning_time) == ("waving", False, 0.0)
    assert row.share_good is None


def test_the_digest_follows_the_file(module: Path) -> None:
    before = resolve_method("waving=waving_agent:Waving").digest
    assert resolve_method("waving=waving_agent:Waving").digest == before
    module.write_text(AGENT.replace("0.2 if", "0.3 if"))
    assert resolve_method("waving=waving_agent:Waving").digest != before


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("a=waving_agent:Neither", "planner, which has plan"),
        ("a=waving_agent:number", "must be a class, got 3"),
        ("a=waving_agent:Missing", "has no 'Missing'"),
        ("a=absent_agent:Waving", "no module 'absent_agent'"),
        ("smp=waving_agent:Waving", "'smp' of a method is taken"),
        ("random=waving_agent:Waving", "'random' of a method is taken"),
        ("a/b=waving_agent:Waving", "must be of letters"),
    ],
)
def test_what_is_no_method_is_refused(module: Path, spec: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        resolve_method(spec)


def test_an_agent_is_made_by_the_task_alone(module: Path) -> None:
    with pytest.raises(ValueError, match=r"agent 'a' must be made by the name of a task alone"):
        resolve_method("a=waving_agent:Many").policy("DrawS")


def test_a_learned_planner_without_an_agent_is_refused_before_anything_is_played(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    method = resolve_method("mp_rl")
    method.check([Cell("DrawS", "easy")], None, 2)
    monkeypatch.setattr(bump_planner, "shipped_agent", lambda name, task: tmp_path / "none.json")
    with pytest.raises(ValueError, match=r"mp_rl needs an agent for DrawS.*--agent mp_rl, then"):
        method.check([Cell("DrawS", "easy")], None, 2)
