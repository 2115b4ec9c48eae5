"""The registry of tasks: what ships, and a task from outside that goes through the public seams."""

import subprocess
import sys
import warnings
from dataclasses import replace
from pathlib import Path

import gymnasium
import numpy as np
import pytest
import reach_point
from gymnasium.utils.env_checker import check_env
from stable_baselines3.common.env_checker import check_env as sb3_check_env

import smp_gym
from smp_gym.datasets.demonstrations import Demonstrations
from smp_gym.observation import decode
from smp_gym.robot.pen import pen_path
from smp_gym.sampling import (
    place_without_witness,
    sample_scene,
    sample_with_witness,
)
from smp_gym.scene import FAMILIES, TASKS, Goal, Scene, goal_boxes
from smp_gym.tasks import registry, task_definition, task_names

ID = "smp_gym/ReachPoint-v3"


@pytest.fixture(scope="module", autouse=True)
def registered():
    smp_gym.register_task(reach_point.TASK)
    yield
    del registry._known()["ReachPoint"]
    for id in [id for id in gymnasium.registry if "ReachPoint" in id]:
        del gymnasium.registry[id]


def test_names_ids_and_furniture_follow_from_the_definitions():
    assert TASKS == ("Placement", "DoubleSidedPlacement", "DrawS", "PushLiftBox")
    assert [task for task in TASKS if "shelf" in registry.task_families(task)] == list(TASKS[:2])
    for task in TASKS:
        assert set(registry.task_families(task)) <= set(FAMILIES)
    assert [entry.id for entry in smp_gym.ENVIRONMENTS] == [
        f"smp_gym/{task}{suffix}-v0" for task in TASKS for suffix in ("", "Dense")
    ]
    for task in TASKS:
        assert task_definition(task).rules.name == task


def test_a_task_costs_a_folder_of_four_files():
    assert len(list(Path(reach_point.__file__).parent.glob("*.py"))) <= 4
    assert task_names() == (*TASKS, "ReachPoint")


@pytest.mark.parametrize("id", [ID, "smp_gym/ReachPointDense-v3"])
def test_its_environments_pass_the_checks(id):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = gymnasium.make(id)
        check_env(env.unwrapped, skip_render_check=True)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*PyBullet.*|.*action space.*")
        sb3_check_env(env.unwrapped, skip_render_check=True)
    env.close()


def test_its_scenes_are_functions_of_the_seed_and_go_to_json_and_observation():
    env = gymnasium.make(ID, difficulty="easy")
    observation, info = env.reset(seed=4)
    scene = env.unwrapped.scene
    assert scene == sample_scene("ReachPoint", "easy", 4) != sample_scene("ReachPoint", "easy", 5)
    assert (scene.version, len(scene.obstacles), info["seed"]) == (3, 6, 4)
    assert Scene.from_json(scene.to_json()) == scene
    decoded = decode(observation, "ReachPoint").scene
    assert decoded.manipulated is None
    assert decoded.goals[0].kind == "point"
    assert goal_boxes(decoded.goals[0]) == ()
    np.testing.assert_allclose(decoded.goals[0].position, scene.goals[0].position, atol=1e-6)
    env.close()


def test_its_witness_reaches_the_point_in_the_physics(tmp_path):
    scene, witness = sample_with_witness("ReachPoint", "none", 0)
    np.testing.assert_allclose(pen_path(witness[-1]), scene.goals[0].position)
    told = []
    recorded = task_definition("ReachPoint").demonstrate(told.append)
    assert [line.split(",")[0] for line in told] == [f"demonstration {n}: success" for n in (1, 2)]
    recorded.save(tmp_path / "demonstrations.npz")
    kept = Demonstrations.load(tmp_path / "demonstrations.npz")
    assert kept.scenes[0] == scene
    tips = pen_path(kept.configurations[:, -1])
    goals = np.array([scene.goals[0].position for scene in kept.scenes])
    assert np.linalg.norm(tips - goals, axis=1).max() < 0.03


def test_its_picture_shows_the_point():
    env = gymnasium.make(ID, render_mode="rgb_array", difficulty="none")
    env.reset(seed=0)
    assert env.render().std() > 0
    env.close()


def test_what_it_does_not_have_is_an_error():
    with pytest.raises(ValueError, match="scenes of ReachPoint are not placed without a witness"):
        place_without_witness("ReachPoint", "easy", 0)
    with pytest.raises(ValueError, match="family of ReachPoint must be one of obstacles; got 'sh"):
        sample_scene("ReachPoint", "easy", 0, "shelf")
    with pytest.raises(ValueError, match="family of ReachPoint"):
        gymnasium.make(ID, family="shelf")
    with pytest.raises(ValueError, match=r"kind must be one of .*lift, point; got 'hoop'"):
        Goal(kind="hoop", position=(0.0, 0.0, 0.0))


def test_a_name_is_taken_once():
    smp_gym.register_task(reach_point.TASK)
    with pytest.raises(ValueError, match=r"'Placement' already, in smp_gym\.tasks\.placement"):
        smp_gym.register_task(replace(reach_point.TASK, name="Placement"))
    with pytest.raises(ValueError, match="PushLiftBox, ReachPoint; got 'Juggling'"):
        task_definition("Juggling")


@pytest.mark.parametrize(
    "first", ["smp_gym.scene", "smp_gym.sampling", "smp_gym.datasets.demonstrations", "smp_gym.env"]
)
def test_no_module_is_needed_before_another(first):
    code = f"import {first}; from smp_gym.scene import TASKS; print(TASKS)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "DoubleSidedPlacement" in done.stdout


def test_importing_the_package_imports_no_physics():
    code = "import smp_gym, sys; print([m for m in sys.modules if m == 'pybullet'])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
