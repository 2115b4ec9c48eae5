"""The scripted demonstrators of the tasks, and the script that writes what they record."""

import importlib.util
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import typer

from smp_gym.datasets.demonstrations import Demonstrations
from smp_gym.robot.kinematics import JOINT_VELOCITY, end_effector_pose
from smp_gym.tasks import placing_demonstrator, task_definition
from smp_gym.tasks.double_sided_placement import demonstrator as double_sided
from smp_gym.tasks.performance import SPEED_LIMIT, Performance
from smp_gym.tasks.placement import demonstrator as placement
from smp_gym.tasks.placement.rules import HELD_OBJECT_POSE

SCRIPT = Path(__file__).parents[3] / "scripts" / "record_demonstrations.py"


@pytest.fixture(scope="module")
def script():
    specification = importlib.util.spec_from_file_location("record_demonstrations", SCRIPT)
    module = importlib.util.module_from_spec(specification)
    sys.modules[specification.name] = module
    specification.loader.exec_module(module)
    yield module
    del sys.modules[specification.name]


def performed(monkeypatch, info):
    """Replace every execution by one that moves as told and ends with an info."""

    def perform(env, scene, movement, duration):
        return Performance(scene, movement, duration, movement, np.zeros(4), info)

    monkeypatch.setattr(placing_demonstrator, "_perform", perform)


def test_the_script_writes_nothing_unless_all_succeed(script, tmp_path, monkeypatch):
    performed(monkeypatch, {"is_success": False, "failure": "dropped"})
    with pytest.raises(typer.Exit) as caught:
        script.main(tmp_path / "Placement.npz")
    assert caught.value.exit_code == 1
    assert not list(tmp_path.iterdir())


def test_the_script_writes_what_all_succeeded(script, tmp_path, monkeypatch):
    performed(monkeypatch, {"is_success": True, "failure": ""})
    script.main(tmp_path / "Placement.npz")
    written = Demonstrations.load(tmp_path / "Placement.npz")
    assert len(written) == 7
    assert written.scenes == Demonstrations.load("Placement").scenes


def test_a_movement_faster_than_the_limit_is_an_error(monkeypatch):
    performed(monkeypatch, {"is_success": True, "failure": ""})
    hasty = replace(placement.SCRIPT, duration=(1.0, 1.0))
    with pytest.raises(RuntimeError, match=r"demonstration 1: success, 1.00 s, \d+ % of the speed"):
        hasty.record(lambda told: None)


def test_scripted_movements_keep_within_the_speed_limit():
    rng = np.random.default_rng(11)
    for _ in range(10):
        movement = placement.SCRIPT.movement(rng)
        speed = np.abs(np.diff(movement, axis=0)) * (len(movement) - 1)
        assert (speed / placement.SCRIPT.duration[0] <= SPEED_LIMIT * JOINT_VELOCITY).all()
        assert movement.shape == (200, 6)


@pytest.mark.parametrize("target", [0, 1])
def test_scripted_movements_end_just_above_either_pad(target):
    rng, script = np.random.default_rng(5), double_sided.SCRIPT
    for _ in range(5):
        movement = script.movement(rng, target)
        speed = np.abs(np.diff(movement, axis=0)) * 199 / script.duration[0]
        assert (speed <= SPEED_LIMIT * JOINT_VELOCITY).all()
        held = (end_effector_pose(movement[-1]) @ HELD_OBJECT_POSE)[:3, 3]
        surface = np.array(script.goals[target].position)
        assert np.abs(held - surface)[:2].max() < 0.03
        assert 0.045 < held[2] - surface[2] < 0.07


@pytest.mark.parametrize("task", ["Placement", "PushLiftBox"])
def test_demonstrators_record_what_ships(task):
    told = []
    recorded, shipped = task_definition(task).demonstrate(told.append), Demonstrations.load(task)
    np.testing.assert_allclose(recorded.configurations, shipped.configurations, atol=2e-3)
    np.testing.assert_array_equal(recorded.gripper, shipped.gripper)
    np.testing.assert_array_equal(recorded.durations, shipped.durations)
    assert recorded.scenes == shipped.scenes
    assert set(recorded.metadata) == set(shipped.metadata)
    assert len(told) == 7
    assert "demonstration 7: success" in told[-1]


def test_the_script_knows_its_tasks(script, tmp_path):
    with pytest.raises(typer.BadParameter, match=r"DoubleSided.*PushLiftBox; got 'Juggling'"):
        script.main(tmp_path / "Juggling.npz", task="Juggling")
