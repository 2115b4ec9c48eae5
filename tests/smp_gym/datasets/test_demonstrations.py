import json
import zipfile
from dataclasses import replace
from pathlib import Path

import gymnasium
import numpy as np
import pytest

import smp_gym  # noqa: F401
from smp_gym.datasets.demonstrations import FORMAT_VERSION, Demonstrations, resample
from smp_gym.observation import CONTROL_PERIOD
from smp_gym.robot.kinematics import JOINT_LOWER, JOINT_UPPER, JOINT_VELOCITY, end_effector_pose
from smp_gym.rollout import play
from smp_gym.scene import BIN_INNER_HALF_WIDTH, Goal, ManipulatedObject, Scene
from smp_gym.tasks.placement.rules import HELD_OBJECT_POSE, NOMINAL_BIN, START_CONFIGURATION


def small(**changes):
    scene = Scene(
        task="Placement",
        start=START_CONFIGURATION,
        manipulated=ManipulatedObject(),
        goals=(Goal(position=NOMINAL_BIN),),
    )
    rng = np.random.default_rng(0)
    values = {
        "task": "Placement",
        "configurations": rng.normal(size=(3, 5, 6)),
        "gripper": np.tile([1.0, 1.0, 1.0, 0.0, 0.0], (3, 1)),
        "durations": np.array([10.0, 11.0, 12.0]),
        "scenes": (scene,) * 3,
        "metadata": {"who": "a test", "numbers": [1, 2.5]},
    }
    return Demonstrations(**{**values, **changes})


@pytest.fixture(scope="module")
def shipped():
    return Demonstrations.load("Placement")


def test_shipped_demonstrations_have_the_documented_form(shipped):
    assert shipped.task == "Placement"
    assert shipped.configurations.shape == (7, 200, 6)
    assert len(shipped) == 7
    assert ((shipped.durations >= 10.0) & (shipped.durations <= 14.0)).all()
    assert shipped.release_phase == 1.0
    assert (shipped.gripper[:, :-1] == 1.0).all()
    assert (shipped.gripper[:, -1] == 0.0).all()


def test_shipped_demonstrations_keep_all_limits_and_rest_at_both_ends(shipped):
    q = shipped.configurations
    assert ((q > JOINT_LOWER) & (q < JOINT_UPPER)).all()
    velocity = np.diff(q, axis=1) * 199 / shipped.durations[:, None, None]
    assert (np.abs(velocity) <= 0.9 * JOINT_VELOCITY).all()
    assert np.abs(velocity[:, [0, -1]]).max() < 0.01


def test_shipped_demonstrations_share_the_start_and_end_over_the_bin(shipped):
    assert np.abs(shipped.configurations[:, 0] - START_CONFIGURATION).max() < 2e-3
    ends = (end_effector_pose(shipped.configurations[:, -1]) @ HELD_OBJECT_POSE)[:, :3, 3]
    assert np.abs(ends[:, :2] - NOMINAL_BIN[:2]).max() < BIN_INNER_HALF_WIDTH / 2
    assert np.ptp(ends, axis=0).max() > 0.002


def test_shipped_demonstrations_differ_as_those_of_a_human_would(shipped):
    way = (end_effector_pose(shipped.configurations) @ HELD_OBJECT_POSE)[:, :, :3, 3]
    assert np.ptp(way[..., 2].max(axis=1)) > 0.04
    middle = shipped.configurations[:, 100]
    assert (middle.std(axis=0) > 0.01).all()
    for a in range(7):
        for b in range(a):
            assert np.abs(way[a] - way[b]).max() > 0.01


# All are played where they are recorded anew.
@pytest.mark.parametrize("index", [0, 3, 6])
def test_a_shipped_demonstration_succeeds_in_the_physics(shipped, index, env):
    info = play(
        env,
        shipped.scenes[index],
        shipped.configurations[index],
        duration=shipped.durations[index],
    )
    assert info["is_success"], info


@pytest.fixture(scope="module")
def env():
    made = gymnasium.make("smp_gym/Placement-v0")
    yield made
    made.close()


def test_save_and_load_give_everything_back(tmp_path):
    before = small()
    before.save(tmp_path / "some.npz")
    after = Demonstrations.load(tmp_path / "some.npz")
    assert after.task == before.task
    for name in ("configurations", "gripper", "durations"):
        np.testing.assert_array_equal(getattr(after, name), getattr(before, name))
    assert after.scenes == before.scenes
    assert after.metadata == before.metadata


def test_the_same_demonstrations_give_the_same_bytes(tmp_path):
    small().save(tmp_path / "a.npz")
    small().save(tmp_path / "b.npz")
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


def test_shipped_file_needs_no_pickle():
    path = Path(__file__).parents[3] / "envs_assets" / "demonstrations" / "Placement.npz"
    with np.load(path, allow_pickle=False) as file:
        header = json.loads(str(file["header"]))
    assert header["version"] == FORMAT_VERSION


def test_arrays_are_copies_that_cannot_be_written():
    configurations = np.zeros((2, 4, 6))
    demonstrations = small(
        configurations=configurations,
        gripper=np.ones((2, 4)),
        durations=np.ones(2),
        scenes=small().scenes[:2],
    )
    configurations[:] = 1.0
    assert (demonstrations.configurations == 0.0).all()
    with pytest.raises(ValueError, match="read-only"):
        demonstrations.configurations[0, 0, 0] = 1.0


def test_release_phase_is_where_the_gripper_opens():
    assert small().release_phase == pytest.approx(3 / 4)
    late = np.ones((3, 5))
    assert small(gripper=late).release_phase == 1.0
    first_open = np.tile([0.0, 1.0, 0.0, 0.0, 0.0], (3, 1))
    assert small(gripper=first_open).release_phase == pytest.approx(2 / 4)


def test_mean_is_taken_over_demonstrations():
    demonstrations = small()
    np.testing.assert_allclose(
        demonstrations.mean[2, 3], sum(demonstrations.configurations[:, 2, 3]) / 3
    )


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"task": "Juggling"}, "task must be one of Placement, .*; got 'Juggling'"),
        ({"configurations": np.zeros((3, 5))}, "configurations must have shape"),
        ({"configurations": [np.zeros((5, 6)), np.zeros((4, 6))]}, "array .* inhomogeneous"),
        ({"configurations": [np.zeros((5, 6)), np.zeros((5, 7))]}, "array .* inhomogeneous"),
        ({"configurations": np.zeros((1, 5, 6))}, "at least two demonstrations, got 1"),
        ({"configurations": np.zeros((3, 1, 6))}, "at least two samples, got 1"),
        ({"configurations": np.full((3, 5, 6), np.nan)}, r"finite, got nan at \(0, 0, 0\)"),
        ({"configurations": [["a"]]}, "must be real numbers"),
        ({"gripper": np.ones((3, 4))}, r"gripper must have shape \(3, 5\), got \(3, 4\)"),
        ({"gripper": np.full((3, 5), 1.5)}, r"gripper must lie in \[0, 1\]"),
        ({"durations": np.ones(2)}, "durations must have shape"),
        ({"durations": np.array([1.0, 0.0, 1.0])}, "durations must be positive, got 0.0"),
        ({"durations": np.array([1.0, np.inf, 1.0])}, "durations must be finite, got inf"),
        ({"scenes": ()}, "one scene for each of 3"),
    ],
)
def test_bad_values_are_named(changes, message):
    with pytest.raises(ValueError, match=message):
        small(**changes)


def test_metadata_must_be_json(tmp_path):
    with pytest.raises(ValueError, match="metadata must be JSON"):
        replace(small(), metadata={"f": print}).save(tmp_path / "a.npz")
    with pytest.raises(ValueError, match="metadata must be JSON"):
        replace(small(), metadata={"f": float("nan")}).save(tmp_path / "a.npz")


def test_save_wants_an_npz(tmp_path):
    with pytest.raises(ValueError, match=r"must end in \.npz"):
        small().save(tmp_path / "a.json")


def test_load_names_what_ships_when_nothing_is_there(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"one of .*Placement"):
        Demonstrations.load(tmp_path / "nothing.npz")
    with pytest.raises(FileNotFoundError, match="Juggling"):
        Demonstrations.load("Juggling")


def rewritten(path, **changes):
    """Save arrays of a good file with some entries changed (None: left out)."""
    small().save(path)
    with np.load(path) as file:
        entries = {name: file[name] for name in file.files}
    entries.update(changes)
    np.savez(path, **{name: value for name, value in entries.items() if value is not None})
    return path


def header(**changes):
    scenes = [scene.model_dump(mode="json") for scene in small().scenes]
    values = {"version": FORMAT_VERSION, "task": "Placement", "scenes": scenes, "metadata": {}}
    return np.array(json.dumps({**values, **changes}))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"gripper": None}, "no entry gripper"),
        ({"header": np.array("not json")}, "is not a file of demonstrations"),
        ({"header": np.array("[]")}, "version"),
        ({"header": header(version=99)}, "version must be 1, got 99"),
        ({"header": header(task="Juggling")}, "Juggling"),
        ({"header": header(scenes=[{}, {}, {}])}, "goals"),
        ({"configurations": np.full((3, 5, 6), np.nan)}, "finite"),
        ({"configurations": np.array([{}, {}], object)}, "must hold numbers or texts, got object"),
    ],
)
def test_bad_files_are_named(tmp_path, changes, message):
    path = rewritten(tmp_path / "bad.npz", **changes)
    with pytest.raises(ValueError, match=message) as caught:
        Demonstrations.load(path)
    assert str(path) in str(caught.value)


def test_corrupt_files_are_named(tmp_path):
    path = tmp_path / "bad.npz"
    small().save(path)
    whole = path.read_bytes()
    for content in (
        b"",
        b"hello",
        whole[: len(whole) // 2],
        whole[:200] + b"x" * 100 + whole[300:],
    ):
        path.write_bytes(content)
        with pytest.raises(ValueError, match="is not a file of demonstrations"):
            Demonstrations.load(path)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("configurations.npy", b"nonsense")
    with pytest.raises(ValueError, match="is not a file of demonstrations"):
        Demonstrations.load(path)


def test_resample_is_exact_on_cubics():
    def cubic(x):
        return np.stack([x**3 - x, 2 * x**2 + 1], axis=1)

    result = resample(cubic(np.linspace(0, 1, 23)), 57)
    np.testing.assert_allclose(result, cubic(np.linspace(0, 1, 57)), atol=1e-12)


@pytest.mark.parametrize(
    ("values", "samples", "message"),
    [
        (np.zeros(5), 10, "values must have shape"),
        (np.zeros((3, 6)), 10, "values must have shape"),
        (np.zeros((5, 6)), 1, "samples must be a whole number at least 2, got 1"),
    ],
)
def test_resample_names_bad_values(values, samples, message):
    with pytest.raises(ValueError, match=message):
        resample(values, samples)


def test_control_period_divides_the_durations(shipped):
    steps = shipped.durations / CONTROL_PERIOD
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)
