import importlib.util
import json
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import minari
import numpy as np
import pytest
import typer

from smp_gym.datasets import minari_export
from smp_gym.datasets.demonstrations import Demonstrations
from smp_gym.datasets.minari_export import (
    dataset_path,
    default_dataset_id,
    export_demonstrations,
    import_demonstrations,
)
from smp_gym.env import SUCCESS_REWARD
from smp_gym.scene import STROKE_POINTS

SCRIPT = Path(__file__).parents[3] / "scripts" / "export_minari.py"
ID = "smp_gym/DrawS/demonstrations-v1"


@pytest.fixture(scope="module")
def script():
    specification = importlib.util.spec_from_file_location("export_minari", SCRIPT)
    module = importlib.util.module_from_spec(specification)
    sys.modules[specification.name] = module
    specification.loader.exec_module(module)
    yield module
    del sys.modules[specification.name]


@pytest.fixture(scope="module")
def shipped():
    return Demonstrations.load("DrawS")


@pytest.fixture(scope="module")
def played():
    """Episodes that were played once, for tests of what happens after playing."""
    return {}


@pytest.fixture
def as_played(exported, played, monkeypatch):
    monkeypatch.setattr(minari_export, "_played", lambda env, number, scene, policy: played[number])


@pytest.fixture(scope="module")
def exported(script, shipped, played, tmp_path_factory):
    """Return the folder in which all demonstrations of DrawS lie as a data set."""
    root = tmp_path_factory.mktemp("datasets")
    play = minari_export._played

    def remembered(env, number, scene, policy):
        played[number] = play(env, number, scene, policy)
        return played[number]

    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MINARI_DATASETS_PATH", str(root))
        patch.setattr(minari_export, "_played", remembered)
        done = []
        export_demonstrations(
            shipped, script.tracks(shipped), difficulty="hard", finished=done.append
        )
        assert done == list(range(len(shipped)))
    return root


@pytest.fixture
def dataset(exported, monkeypatch):
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(exported))
    return minari.load_dataset(ID)


@pytest.fixture
def copied(exported, tmp_path, monkeypatch):
    """Return the data folder of a copy that may be damaged."""
    shutil.copytree(exported, tmp_path / "copy")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "copy"))
    return dataset_path(ID) / "data"


def two(demonstrations):
    return replace(
        demonstrations,
        configurations=demonstrations.configurations[:2],
        gripper=demonstrations.gripper[:2],
        durations=demonstrations.durations[:2],
        scenes=demonstrations.scenes[:2],
    )


class Dive:
    """Drives into the table."""

    def predict(self, observation, state, episode_start, deterministic):
        action = np.zeros(7, np.float32)
        action[1] = 1.0
        return action, None


def contents(folder):
    return {p.relative_to(folder): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def assert_equal(first, second):
    assert first.task == second.task
    for name in ("configurations", "gripper", "durations"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))
    assert first.scenes == second.scenes
    assert first.metadata == second.metadata


def test_demonstrations_come_back_exactly(dataset, shipped):
    assert_equal(import_demonstrations(dataset), shipped)
    assert_equal(import_demonstrations(ID), shipped)
    some = dataset.filter_episodes(lambda episode: episode.id in (2, 5))
    np.testing.assert_array_equal(
        import_demonstrations(some).configurations, shipped.configurations[[2, 5]]
    )


def test_a_dataset_holds_whole_successful_episodes(dataset, shipped):
    assert list(minari.list_local_datasets()) == [ID]
    assert dataset.total_episodes == len(shipped)
    assert dataset.total_steps == sum(len(episode) for episode in dataset)
    for episode in dataset:
        steps = len(episode)
        for key, space in dataset.observation_space.items():
            assert episode.observations[key].shape == (steps + 1, *space.shape)
            assert episode.observations[key].dtype == space.dtype
        assert episode.actions.shape == (steps, 7)
        assert episode.actions.dtype == np.float32
        np.testing.assert_array_equal(episode.rewards, [0.0] * (steps - 1) + [SUCCESS_REWARD])
        np.testing.assert_array_equal(episode.terminations, [False] * (steps - 1) + [True])
        assert not episode.truncations.any()
        np.testing.assert_array_equal(episode.infos["is_success"], [False] * steps + [True])
        assert set(episode.infos) >= {"clearance", "collided", "failure"}
        # The goal is a stroke whose end the pen has reached.
        last = {key: vector[-1] for key, vector in episode.observations.items()}
        ends = [last[f"{kind}_goal"][: 3 * STROKE_POINTS][-3:] for kind in ("achieved", "desired")]
        assert np.linalg.norm(ends[0] - ends[1]) < 0.025


@pytest.mark.parametrize("number", [0, 6])
def test_the_environment_comes_back_and_plays_an_episode_bit_for_bit(dataset, number):
    env = dataset.recover_environment()
    assert env.unwrapped.difficulty == "hard"
    assert env.observation_space == dataset.observation_space
    (row,) = dataset.storage.get_episode_metadata([number])
    episode = dataset[number]
    observations = [env.reset(options=row["options"])[0]]
    for action, reward in zip(episode.actions, episode.rewards, strict=True):
        observation, again, *_ = env.step(action)
        assert again == reward
        observations.append(observation)
    env.close()
    for key, vectors in episode.observations.items():
        np.testing.assert_array_equal(np.stack([o[key] for o in observations]), vectors)


def test_an_episode_that_fails_is_refused_and_nothing_changes(copied, script, shipped):
    root = copied.parents[3]
    before = contents(root)
    some = two(shipped)
    good, _ = script.tracks(some)
    for policies, named in (
        ([Dive(), good], "1 did not succeed: coll"),
        ([good, Dive()], "2 did not"),
    ):
        with pytest.raises(RuntimeError, match=named):
            export_demonstrations(some, policies, overwrite=True)
        with pytest.raises(RuntimeError, match=named):
            export_demonstrations(some, policies, "other/new-v0")
    assert contents(root) == before
    assert sorted(p.name for p in root.iterdir()) == ["smp_gym"]


def test_an_export_that_breaks_off_while_writing_leaves_nothing(
    as_played, script, shipped, tmp_path, monkeypatch
):
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    monkeypatch.setattr(minari_export, "AUTHOR", {})
    some = two(shipped)
    with pytest.raises(TypeError):
        export_demonstrations(some, script.tracks(some))
    assert not list(tmp_path.iterdir())


def test_the_script_writes_and_overwrites_only_when_told(
    as_played, script, shipped, tmp_path, monkeypatch
):
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "elsewhere"))
    some, file = two(shipped), tmp_path / "two.npz"
    some.save(file)
    arguments = {"out": tmp_path / "root", "dataset_id": "mine-v3"}
    script.main(str(file), **arguments)
    assert_equal(import_demonstrations("mine-v3"), some)
    before = contents(tmp_path)
    with pytest.raises(typer.Exit) as caught:
        script.main(str(file), **arguments)
    assert caught.value.exit_code == 1
    assert contents(tmp_path) == before
    turned = replace(some, metadata={**some.metadata, "note": "again"})
    turned.save(file)
    script.main(str(file), **arguments, overwrite=True)
    assert_equal(import_demonstrations("mine-v3"), turned)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["root", "two.npz"]
    assert [p.name for p in (tmp_path / "root").iterdir()] == ["mine-v3"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"task": "Juggling"}, "Juggling"),
        ({"difficulty": "silly"}, "none, easy, medium, hard; got 'silly'"),
        ({"dataset_id": "no version"}, "like 'namespace/name-v0', got 'no version'"),
        ({"dataset_id": "unversioned"}, "got 'unversioned'"),
        ({"dataset_id": "../escape-v0"}, "got '../escape-v0'"),
    ],
)
def test_the_script_names_what_is_wrong(script, tmp_path, monkeypatch, capsys, arguments, message):
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    with pytest.raises(typer.Exit):
        script.main(**{"task": "DrawS", "out": tmp_path, **arguments})
    assert message in capsys.readouterr().out
    assert not list(tmp_path.iterdir())


def test_every_demonstration_needs_its_policy(script, shipped, tmp_path, monkeypatch):
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    with pytest.raises(ValueError, match="each of 7 demonstrations, got 2"):
        export_demonstrations(shipped, script.tracks(two(shipped)))


def test_a_missing_dataset_is_a_clear_error(copied):
    with pytest.raises(FileNotFoundError, match="nowhere-v0"):
        import_demonstrations("nowhere-v0")


def cut(folder):
    file = folder / "main_data.hdf5"
    file.write_bytes(file.read_bytes()[:5000])


def scribble(folder):
    (folder / "metadata.json").write_text("{")


def forget(folder):
    (folder / "main_data.hdf5").unlink()


def changed_header(**changes):
    def change(folder):
        file = folder / "metadata.json"
        values = json.loads(file.read_text())
        header = json.loads(values["smp_gym_demonstrations"])
        values["smp_gym_demonstrations"] = json.dumps({**header, **changes})
        file.write_text(json.dumps(values))

    return change


def foreign(folder):
    file = folder / "metadata.json"
    values = json.loads(file.read_text())
    del values["smp_gym_demonstrations"]
    file.write_text(json.dumps(values))


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (cut, "is not a data set of demonstrations"),
        (scribble, "is not a data set of demonstrations"),
        (forget, "is not a data set of demonstrations"),
        (foreign, "was not exported by smp_gym"),
        (changed_header(version=99), "version must be 1, got 99"),
        (changed_header(task="Placement"), "must be of task 'Placement', got 'DrawS'"),
    ],
)
def test_damaged_and_foreign_datasets_are_named(copied, damage, message):
    assert import_demonstrations(ID).task == "DrawS"
    damage(copied)
    with pytest.raises(ValueError, match=message) as caught:
        import_demonstrations(ID)
    assert ID in str(caught.value)


@pytest.mark.parametrize("package", ["minari", "h5py"])
def test_without_the_extra_the_error_says_what_to_install(package, shipped, monkeypatch):
    monkeypatch.setitem(sys.modules, package, None)
    for call in (
        lambda: export_demonstrations(shipped, []),
        lambda: import_demonstrations(ID),
        lambda: dataset_path(ID),
    ):
        with pytest.raises(ImportError, match=rf"{package}.*smp-gym\[minari\]"):
            call()


def test_ids_follow_the_task():
    assert default_dataset_id("DrawS") == ID
