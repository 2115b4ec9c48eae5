"""The checks of environments on every id, but short."""

import runpy
import subprocess
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import typer

import smp_gym
from smp_gym.env import ManipulationEnv
from smp_gym.inspection import checking
from smp_gym.physics import workcell

ROOT = Path(__file__).parents[3]
SCRIPT = ROOT / "scripts" / "check_environments.py"
IDS = [entry.id for entry in smp_gym.ENVIRONMENTS]
STEPS = 200
RESETS = 300
MOST_GROWTH = 1.5
"""MB in the last 200 of so many resets; PyBullet, left alone, takes 10 for clutter. Scenes of the
family "obstacles" take and free as much while they are drawn, which hides it."""


@pytest.mark.parametrize("id", IDS)
def test_checkers_of_gymnasium_and_stable_baselines3_find_nothing(id):
    # The reward does not reach the scenes, and those without obstacles are drawn at once.
    checking.check_interfaces(id, "none" if id.endswith("Dense-v0") else "hard")


@pytest.mark.parametrize("id", IDS)
def test_observations_stay_in_bounds_whatever_happens(id):
    bounds = checking.check_bounds(id, STEPS)
    assert bounds.collisions >= 1
    assert 0.001 < bounds.velocity < 1.0


def test_a_velocity_that_is_cut_is_found(monkeypatch):
    encode = ManipulationEnv._observe

    def rushing(env):
        observation = encode(env)
        observation["observation"][12] = 10.0
        return observation

    monkeypatch.setattr(ManipulationEnv, "_observe", rushing)
    with pytest.raises(AssertionError, match="may have been cut"):
        checking.check_bounds(IDS[0], 5)


def test_an_episode_is_the_same_bit_for_bit_after_others_and_in_another_process(monkeypatch):
    # The ids of a task play the same scenes.
    monkeypatch.setattr(checking, "sample_scene", cache(checking.sample_scene))
    seeds, digests = {}, {}
    for entry in smp_gym.ENVIRONMENTS:
        # The reward does not reach the physics.
        others, steps = (4, checking.ROLLOUT_STEPS) if entry.reward == "sparse" else (1, 5)
        seeds[entry.id], digest = checking.check_repeats(entry.id, others, other_steps=steps)
        digests[entry.id] = digest
    assert len(set(digests.values())) == len(IDS)
    # Each task, and each reward, once or more.
    elsewhere = [IDS[0], *IDS[3::2]]
    found = checking.digests_elsewhere({id: seeds[id] for id in elsewhere})
    assert found == [digests[id] for id in elsewhere]


def test_an_episode_that_remembers_another_is_found(monkeypatch):
    reset = ManipulationEnv.reset

    def leaking(env, **arguments):
        env.resets = getattr(env, "resets", 0) + 1
        observation, info = reset(env, **arguments)
        observation["observation"][0] += 1e-6 * env.resets
        return observation, info

    monkeypatch.setattr(ManipulationEnv, "reset", leaking)
    with pytest.raises(AssertionError, match="differs after 1 other"):
        checking.check_repeats(IDS[0], 1, other_steps=1)


def test_memory_does_not_grow_along_resets(monkeypatch):
    monkeypatch.setattr(workcell, "_SCENES_PER_WORLD", 50)
    env = checking.make(IDS[0], difficulty="hard", family="clutter")
    memory = checking.memory_along_resets(env, RESETS, samples=4, new_scene_every=RESETS // 5)
    env.close()
    assert len(memory) == 4
    assert np.diff(memory[1:]).sum() < MOST_GROWTH, memory


def test_memory_that_grows_is_seen():
    """A world that is never rebuilt keeps the shapes of all its scenes."""
    code = (
        "from smp_gym.inspection import checking\n"
        "from smp_gym.physics import workcell; workcell._SCENES_PER_WORLD = 10**6\n"
        f"env = checking.make({IDS[0]!r}, difficulty='hard', family='clutter')\n"
        f"print(*checking.memory_along_resets(env, {RESETS}, 4, new_scene_every={RESETS // 5}))"
    )
    # In a process of its own: here, what other tests have freed would be used up first.
    output = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout
    memory = [float(number) for number in output.splitlines()[-1].split()]
    assert np.diff(memory[1:]).sum() > MOST_GROWTH, memory


def test_worlds_are_rebuilt_before_they_weigh_much():
    # 27 kB a reset at difficulty hard.
    assert workcell._SCENES_PER_WORLD <= 500


def test_unknown_ids_are_named():
    with pytest.raises(typer.BadParameter, match=r"Placement-v0.*got 'smp_gym/Juggling-v0'"):
        runpy.run_path(str(SCRIPT))["main"](ids="smp_gym/Juggling-v0")
