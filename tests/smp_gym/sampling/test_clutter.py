import json
import os
import subprocess
import sys

import gymnasium
import numpy as np
import pybullet
import pytest

import smp_gym  # noqa: F401
from smp_gym.rollout import play
from smp_gym.sampling import CROWDED, sample_with_witness
from smp_gym.sampling.clutter import HALF_EXTENTS
from smp_gym.scene import Scene

TASKS = ("Placement", "DoubleSidedPlacement")
SOLIDS = {"easy": 6, "medium": 12, "hard": 16}
CELLS = [(task, difficulty) for task in TASKS for difficulty in CROWDED]


@pytest.fixture(scope="module")
def drawn():
    """Two cluttered scenes with witnesses of each task and difficulty."""
    return {
        (task, difficulty): [
            sample_with_witness(task, difficulty, seed, "clutter") for seed in (0, 1)
        ]
        for task, difficulty in CELLS
    }


def test_a_cluttered_scene_is_the_same_in_another_process(drawn):
    code = (
        "from smp_gym.sampling import sample_with_witness\n"
        "scene, witness = sample_with_witness('Placement', 'hard', 1, 'clutter')\n"
        "print(scene.to_json())\n"
        "print(witness.tobytes().hex())\n"
    )
    answer = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "OMP_NUM_THREADS": "2", "PYTHONHASHSEED": "5"},
        capture_output=True,
        text=True,
        check=True,
    )
    scene, witness = drawn["Placement", "hard"][1]
    assert answer.stdout.split() == [*scene.to_json().split(), witness.tobytes().hex()]


@pytest.mark.parametrize(("task", "difficulty"), CELLS)
def test_solids_are_many_and_of_mixed_shape_and_size(drawn, task, difficulty):
    first, second = (scene for scene, _ in drawn[task, difficulty])
    assert first.obstacles != second.obstacles
    for scene in (first, second):
        assert (scene.family, scene.difficulty) == ("clutter", difficulty)
        assert Scene.from_json(json.dumps(json.loads(scene.to_json()))) == scene
        assert len(scene.obstacles) == SOLIDS[difficulty]
        sizes = np.array([body.size for body in scene.obstacles])
        assert sizes.min() >= HALF_EXTENTS[0]
        assert sizes.max() <= HALF_EXTENTS[1]
        assert np.ptp(sizes) > 0.01
        assert len({body.shape for body in scene.obstacles}) >= 2


def resting(body, others):
    """Return whether an obstacle stands on the table or on another one below it."""
    bottom = body.position[2] - body.size[2]
    return abs(bottom) < 1e-9 or any(
        abs(bottom - other.position[2] - other.size[2]) < 1e-9
        and np.hypot(*np.subtract(body.position, other.position)[:2]) < max(other.size[:2])
        for other in others
        if other is not body
    )


@pytest.mark.parametrize(("task", "difficulty"), CELLS)
def test_most_solids_stand_on_something(drawn, task, difficulty):
    for scene, _ in drawn[task, difficulty]:
        hanging = [body for body in scene.obstacles if not resting(body, scene.obstacles)]
        assert len(hanging) <= len(scene.obstacles) / 3
        assert all(body.position[2] - body.size[2] > 0.2 for body in hanging)


def test_no_solids_overlap(drawn):
    """As Bullet measures it: what is stacked touches, all else is apart."""
    client = pybullet.connect(pybullet.DIRECT)
    kinds = {
        "box": lambda size: {"shapeType": pybullet.GEOM_BOX, "halfExtents": size},
        "sphere": lambda size: {"shapeType": pybullet.GEOM_SPHERE, "radius": size[0]},
        "cylinder": lambda size: {
            "shapeType": pybullet.GEOM_CYLINDER,
            "radius": size[0],
            "height": 2 * size[2],
        },
    }
    try:
        for scenes in drawn.values():
            for scene, _ in scenes:
                pybullet.resetSimulation(physicsClientId=client)
                bodies = [
                    pybullet.createMultiBody(
                        0,
                        pybullet.createCollisionShape(
                            **kinds[body.shape](body.size), physicsClientId=client
                        ),
                        -1,
                        body.position,
                        body.quaternion,
                        physicsClientId=client,
                    )
                    for body in scene.obstacles
                ]
                for number, one in enumerate(bodies):
                    for other in bodies[:number]:
                        near = pybullet.getClosestPoints(one, other, 0.01, physicsClientId=client)
                        assert min([pair[8] for pair in near], default=1.0) > -1e-3
    finally:
        pybullet.disconnect(client)


@pytest.mark.parametrize("task", TASKS)
def test_witnesses_succeed_in_the_physics(drawn, task):
    env = gymnasium.make(f"smp_gym/{task}-v0")
    try:
        for difficulty in CROWDED:
            for scene, witness in drawn[task, difficulty][: 2 if difficulty == "hard" else 1]:
                info = play(env, scene, witness)
                assert info["is_success"], (difficulty, scene.seed, info)
    finally:
        env.close()
