"""Frozen lists: what is in them, and the wrapper that plays them in order."""

import gzip
import json
from functools import cache, partial

import gymnasium
import numpy as np
import pytest
from stable_baselines3.common.callbacks import EvalCallback
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import DummyVecEnv

from smp_gym.datasets.frozen import (
    HALVES,
    FrozenEpisode,
    FrozenEpisodes,
    frozen_lists,
    list_path,
    load_episodes,
    load_unknown,
    read_header,
    write_episodes,
)
from smp_gym.observation import MAX_EPISODE_STEPS, decode
from smp_gym.sampling import sample_scene
from smp_gym.scene import EVALUATION_RANGE_START
from smp_gym.suites import Cell

PLACEMENT = "smp_gym/Placement-v0"
EASY = Cell("Placement", "easy")
STEPS = 3


@pytest.mark.parametrize("cell", frozen_lists(), ids=lambda cell: cell.name)
def test_a_list_holds_what_its_header_says(cell):
    """Of every list that ships."""
    header, kept, unknown = read_header(cell), load_episodes(cell), load_unknown(cell)
    assert len(kept) == header["episodes"] == 100
    assert len(unknown) == header["unknown"]
    assert set(header["versions"]) >= {"numpy", "pybullet", "python"}
    assert sum(header["solvers"].values()) == 100
    for half, counts in header["halves"].items():
        of_half = [e for e in (*kept, *unknown) if e.half == half]
        assert counts["drawn"] == counts["kept"] + counts["unknown"] == len(of_half)
        assert sorted(e.seed for e in of_half) == list(
            range(EVALUATION_RANGE_START, EVALUATION_RANGE_START + len(of_half))
        )
    assert len({episode.scene.to_json() for episode in kept}) == 100


def test_cells_without_a_list_are_refused(tmp_path):
    with pytest.raises(ValueError, match=r"of Placement_none: no suite holds it.* standard, tight"):
        load_episodes(Cell("Placement", "none"))
    with pytest.raises(ValueError, match=r"of Placement_easy, no file .*; there are: none"):
        load_episodes(EASY, tmp_path)


# Files


@cache
def small(count=6):
    return tuple(
        FrozenEpisode(HALVES[i % 2], 7 + i // 2, sample_scene("Placement", "easy", i), "reference")
        for i in range(count)
    )


@cache
def unsolved(seed=9):
    return FrozenEpisode("placed", seed, sample_scene("Placement", "easy", seed))


def test_lists_survive_the_disk(tmp_path):
    path = list_path(EASY, tmp_path)
    write_episodes(path, {"made": "here"}, small(), [unsolved()])
    before = path.read_bytes()
    write_episodes(path, {"made": "here"}, small(), [unsolved()])
    assert path.read_bytes() == before
    assert load_episodes(EASY, tmp_path) == small()
    assert load_unknown(EASY, tmp_path) == (unsolved(),)
    assert read_header(EASY, tmp_path)["made"] == "here"
    assert frozen_lists(tmp_path) == (EASY,)
    # What is sensed has no say in what is there.
    assert load_episodes(Cell("Placement", "easy", sensing="depth"), tmp_path) == small()


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda lines: lines[:-1], "6 episodes and 1 unknown announced, 6 there"),
        (lambda lines: [lines[0].replace("smp_gym", "gym"), *lines[1:]], "its format is gym"),
        (lambda lines: [lines[0], lines[1].replace("bin", "bun"), *lines[2:]], "line 2"),
        (lambda lines: [*lines[:-1], lines[-1].replace("placed", "good")], "line 8.*witness"),
        (
            lambda lines: [lines[0], lines[1].replace('"easy"', '"hard"'), *lines[2:]],
            "line 2.*Placement, hard",
        ),
        (
            lambda lines: [lines[0], lines[-1], *lines[1:-1]],
            "line 2.*number 1 of 6, solved by ''",
        ),
        (lambda _: ["[]"], "not a list of episodes"),
    ],
)
def test_damaged_lists_are_refused(tmp_path, damage, message):
    path = list_path(EASY, tmp_path)
    write_episodes(path, {}, small(), [unsolved()])
    lines = damage(gzip.decompress(path.read_bytes()).decode().splitlines())
    path.write_bytes(gzip.compress("\n".join(lines).encode()))
    with pytest.raises(ValueError, match=message):
        load_episodes(EASY, tmp_path)


def test_a_list_of_the_first_format_says_what_is_allowed(tmp_path):
    path = list_path(EASY, tmp_path)
    path.parent.mkdir()
    old = {"format": "smp_gym.episodes", "version": 1, "task": "Placement", "episodes": 0}
    path.write_bytes(gzip.compress(json.dumps(old).encode()))
    expected = r"Placement_easy.*its format is smp_gym.episodes 1, allowed is smp_gym.episodes 2"
    with pytest.raises(ValueError, match=expected):
        load_episodes(EASY, tmp_path)


def test_a_file_that_is_no_archive_is_refused(tmp_path):
    path = list_path(EASY, tmp_path)
    path.parent.mkdir()
    path.write_text(json.dumps({}))
    with pytest.raises(ValueError, match="not a list of episodes"):
        load_episodes(EASY, tmp_path)


# The wrapper


def make(episodes, **arguments):
    env = gymnasium.make(PLACEMENT, max_episode_steps=STEPS)
    return FrozenEpisodes(env, episodes, **arguments)


def play(env):
    """Play one episode and return its index in the list."""
    _, info = env.reset()
    index = info["frozen_episode"]
    over = False
    while not over:
        _, _, terminated, truncated, info = env.step(np.zeros(7, np.float32))
        over = terminated or truncated
        assert info["frozen_episode"] == index
    return index


def test_episodes_are_played_in_order_and_from_the_list():
    episodes = small(3)
    env = make(episodes)
    for index in (0, 1, 2, 0, 1):
        assert play(env) == index
        assert env.unwrapped.scene == episodes[index].scene
    _, info = env.reset()
    assert (info["frozen_episode"], info["half"]) == (2, HALVES[0])
    env.close()


def test_a_reset_within_an_episode_begins_the_list_anew():
    env = make(small(4), start=1)
    assert play(env) == 1
    assert play(env) == 2
    env.reset()
    env.step(np.zeros(7, np.float32))
    assert env.reset()[1]["frozen_episode"] == 1
    assert env.reset()[1]["frozen_episode"] == 1
    assert env.reset(options={"episode": 3})[1]["frozen_episode"] == 3
    env.close()


def test_a_seed_chooses_no_episode_but_seeds_the_generator():
    env = make(small(2))
    env.reset(seed=5)
    assert env.reset(seed=5)[1]["frozen_episode"] == 0
    expected = np.random.default_rng(5).random()
    assert env.unwrapped.np_random.random() == expected
    env.close()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"episodes": ()}, "at least one"),
        ({"start": 6}, "start must be from 0 to 5, got 6"),
        ({"start": -1}, "start"),
        ({"stride": 0}, "stride must be at least 1, got 0"),
    ],
)
def test_bad_arguments(arguments, message):
    env = gymnasium.make(PLACEMENT)
    with pytest.raises(ValueError, match=message):
        FrozenEpisodes(env, **{"episodes": small(), **arguments})
    env.close()


def test_bad_options():
    env = make(small(2))
    for options, message in (
        ({"episode": 2}, "from 0 to 1, got 2"),
        ({"episode": "1"}, "from 0 to 1"),
        ({"scene": "…"}, "'episode' only"),
    ):
        with pytest.raises(ValueError, match=message):
            env.reset(options=options)
    env.reset()
    env.close()


class Still:
    """A policy that stays where it is and keeps the scenes that it meets."""

    def __init__(self):
        self.met = []

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        rows = len(observation["observation"])
        for i in range(rows):
            decoded = decode({k: v[i] for k, v in observation.items()}, "Placement")
            if decoded.elapsed_steps == 0:
                self.met.append(decoded.scene.goals[0].position)
        return np.zeros((rows, 7), np.float32), None


def counted(model, env, count):
    """Return the episodes that `evaluate_policy` counts, by the list's index."""
    found = []

    def keep(variables, _):
        if variables["done"]:
            i, counts = variables["i"], variables["episode_counts"]
            if counts[i] < variables["episode_count_targets"][i]:
                found.append(variables["info"]["frozen_episode"])

    evaluate_policy(model, env, n_eval_episodes=count, callback=keep, warn=False)
    return found


@pytest.mark.parametrize(("environments", "episodes"), [(1, 4), (2, 6), (3, 5), (4, 6)])
def test_evaluate_policy_plays_each_episode_once_every_time(environments, episodes):
    n = environments
    makers = [
        partial(make, small(episodes), start=n - 1 - i, stride=n) for i in range(environments)
    ]
    env = DummyVecEnv(makers)
    for _ in range(2):
        assert sorted(counted(Still(), env, episodes)) == list(range(episodes))
    env.close()


def test_an_evaluation_callback_plays_the_same_episodes_each_time(tmp_path):
    from stable_baselines3 import SAC

    env = gymnasium.make(PLACEMENT, difficulty="none")
    model = SAC("MultiInputPolicy", env, learning_starts=1000, seed=0)
    evaluated = DummyVecEnv([partial(make, small(3))])
    seen = []
    evaluated.env_method("reset")
    callback = EvalCallback(evaluated, n_eval_episodes=3, eval_freq=5, verbose=0, warn=False)
    original = FrozenEpisodes.reset

    def spy(self, **arguments):
        result = original(self, **arguments)
        seen.append(result[1]["frozen_episode"])
        return result

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(FrozenEpisodes, "reset", spy)
        model.learn(10, callback=callback)
    # stable-baselines3 resets once more after the last episode.
    assert seen == [0, 1, 2, 0, 0, 1, 2, 0]
    env.close()
    evaluated.close()


def test_time_that_runs_out_ends_an_episode():
    env = FrozenEpisodes(gymnasium.make(PLACEMENT), small(2))
    env.reset()
    for _ in range(MAX_EPISODE_STEPS):
        truncated = env.step(np.zeros(7, np.float32))[3]
    assert truncated
    assert env.reset()[1]["frozen_episode"] == 1
    env.close()
