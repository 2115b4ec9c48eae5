"""Saved states: what follows a restored one is what followed the saved one, bit for bit."""

import dataclasses
import pickle

import gymnasium
import numpy as np
import pytest

from smp_gym.env import ManipulationEnv
from smp_gym.physics.workcell import Workcell
from smp_gym.sampling import sample_scene

STEPS = 90
RELEASE = 30


@pytest.fixture(scope="module")
def env():
    env = ManipulationEnv(reward="dense")
    yield env
    env.close()


def actions(seed, count=STEPS):
    """Return actions that carry, let go after `RELEASE` steps, and run into things."""
    rng = np.random.default_rng(seed)
    moves = np.repeat(rng.uniform(-0.6, 0.6, (count // 15 + 1, 7)), 15, axis=0)[:count]
    moves[:, 6] = np.where(np.arange(count) < RELEASE, 0.2, -1.0)
    return moves.astype(np.float32)


def continued(env, moves):
    """Return all that a rollout gives out, and what the next reset draws."""
    results = []
    for action in moves:
        observation, reward, terminated, _, info = env.step(action)
        results.append((reward, terminated, {k: str(v) for k, v in info.items()}))
        results.append({key: vector.tobytes() for key, vector in observation.items()})
        results.append(env._cell.manipulated.position.tobytes())
    return results, env.reset()[1]["seed"]


def begin(env, seed, moves):
    env.reset(seed=seed)
    # Scenes with obstacles end in collisions, those without in a drop.
    difficulty = "hard" if seed % 2 else "none"
    env.reset(options={"scene": sample_scene("Placement", difficulty, seed)})
    for action in moves:
        env.step(action)


# Before any step, in the hand, at the moment of letting go, falling, lying, past collisions.
@pytest.mark.parametrize("seed", [0, 3])
@pytest.mark.parametrize("at", [0, 12, RELEASE + 3, RELEASE + 7, 80])
def test_what_follows_is_the_same_bit_for_bit(env, seed, at):
    moves = actions(seed)
    begin(env, seed, moves[:at])
    state = env.save_state()
    expected = continued(env, moves[at:])
    begin(env, seed + 50, actions(seed + 50)[:40])
    env.restore_state(state)
    assert continued(env, moves[at:]) == expected


def test_saving_changes_nothing(env):
    moves = actions(1)
    begin(env, 1, [])
    expected = continued(env, moves)
    begin(env, 1, [])
    for action in moves:
        env.save_state()
        env.step(action)
        state = env.save_state()
    assert env.reset()[1]["seed"] == expected[1]
    env.restore_state(state)
    position = env._cell.manipulated.position.tobytes()
    assert position == expected[0][-1]


def test_the_rollouts_of_these_tests_touch_and_collide(env):
    """Without contacts and collisions the tests above would show little."""
    ends = []
    for seed in range(4):
        begin(env, seed, [])
        *_, last = [env.step(action)[4] for action in actions(seed)]
        ends.append(last["failure"])
    assert "collision" in ends
    assert "dropped" in ends


def test_several_states_are_alive_at_once_and_restored_in_any_order(env):
    moves = actions(2)
    begin(env, 2, [])
    states, expected = [], []
    for step, action in enumerate(moves):
        if step % 20 == 0:
            states.append(env.save_state())
        expected.append(env.step(action)[0]["observation"].tobytes())
    for k in (3, 0, 4, 4, 1, 2):
        observation, info = env.restore_state(states[k])
        if k:
            assert observation["observation"].tobytes() == expected[20 * k - 1]
        assert info["seed"] == 2
        assert env.step(moves[20 * k])[0]["observation"].tobytes() == expected[20 * k]


def test_a_state_ahead_in_the_present_episode_is_reached_without_beginning_anew(env, monkeypatch):
    moves = actions(3)
    begin(env, 3, moves[:10])
    early = env.save_state()
    for action in moves[10:20]:
        env.step(action)
    late = env.save_state()
    expected = env._observe()["observation"].tobytes()
    env.restore_state(early)
    monkeypatch.setattr(Workcell, "load", lambda *_: pytest.fail("began anew"))
    observation, _ = env.restore_state(late)
    assert observation["observation"].tobytes() == expected
    observation, _ = env.restore_state(late)
    assert observation["observation"].tobytes() == expected


def test_a_state_outlives_its_world_and_its_environment():
    moves = actions(4)
    first = ManipulationEnv()
    begin(first, 4, moves[:40])
    state = pickle.loads(pickle.dumps(first.save_state()))
    expected = continued(first, moves[40:])
    # Another configuration to begin in makes the workcell build its world anew.
    scene = sample_scene("Placement", "none", 0)
    start = tuple(np.add(scene.start, 0.1).tolist())
    first.reset(options={"scene": scene.model_copy(update={"start": start})})
    first.restore_state(state)
    assert continued(first, moves[40:]) == expected
    first.close()
    second = ManipulationEnv(difficulty="easy")
    second.restore_state(state)
    results, _ = continued(second, moves[40:])
    assert [r for r in results if isinstance(r, bytes)] == [
        r for r in expected[0] if isinstance(r, bytes)
    ]
    second.close()


def test_a_state_that_cannot_be_reached_again_is_a_clear_error(env):
    begin(env, 5, actions(5)[:20])
    state = env.save_state()
    other = state.actions.copy()
    other[3, 0] += 1e-9
    with pytest.raises(RuntimeError, match="20 steps"):
        env.restore_state(dataclasses.replace(state, actions=other))
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(np.zeros(7, np.float32))
    env.restore_state(state)


def test_bad_states_are_refused_and_the_environment_stays_usable(env):
    env.reset(seed=0)
    state = env.save_state()
    with pytest.raises(TypeError, match="int"):
        env.restore_state(5)
    alien = state.scene.model_copy(update={"task": "Juggling"})
    with pytest.raises(ValueError, match="Juggling"):
        env.restore_state(dataclasses.replace(state, scene=alien))
    env.step(np.zeros(7, np.float32))


def test_there_is_no_state_before_the_first_reset():
    env = ManipulationEnv()
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.save_state()
    env.close()
    with pytest.raises(RuntimeError, match="closed"):
        env.save_state()
