"""Allowed collision matrices of MoveIt's scenes in plans, seen by PyBullet."""

import json
import logging
from dataclasses import replace

import numpy as np
import pybullet
import pytest
from kuka_swings import KUKA, LINKS, swings
from pybullet_utils.bullet_client import BulletClient

from smp_planner import SMP, PlanningScene, Robot

pytest.importorskip("yaml", reason="PyYAML is not installed")

MOVING = LINKS[1:]
ROD = {
    "link_name": LINKS[7],
    "object": {
        "id": "rod",
        "header": {"frame_id": LINKS[7]},
        "primitives": [{"type": "cylinder", "dimensions": [0.2, 0.02]}],
        "primitive_poses": [{"position": [0, 0, 0.3]}],
    },
}


@pytest.fixture(scope="module")
def kuka():
    return Robot.from_urdf(KUKA, LINKS[7], overshoot=0.04)


@pytest.fixture(scope="module")
def middle(kuka):
    return kuka.tool_positions(swings()[0][40]).tolist()


@pytest.fixture
def load(kuka, middle, tmp_path, caplog):
    """Return a function that loads a scene with a ball in the way, and returns the warnings."""

    def loaded(pairs=(), others=(), robot=kuka, held=(), **defaults):
        names = sorted({name for pair in pairs for name in pair} | set(others))
        rows = [[[a, b] in pairs or [b, a] in pairs for b in names] for a in names]
        ball = {"primitives": [{"type": "sphere", "dimensions": [0.06]}]}
        ball["primitive_poses"] = [{"position": middle}]
        shelf = {"primitives": [{"type": "box", "dimensions": [0.1, 0.1, 0.1]}]}
        shelf["primitive_poses"] = [{"position": [0, 0, 3]}]
        message = {
            "world": {"collision_objects": [{"id": "ball", **ball}, {"id": "shelf", **shelf}]},
            "robot_state": {"attached_collision_objects": list(held)},
            "allowed_collision_matrix": {
                "entry_names": names,
                "entry_values": rows,
                "default_entry_names": list(defaults),
                "default_entry_values": list(defaults.values()),
            },
        }
        path = tmp_path / "scene.yaml"
        path.write_text(json.dumps(message))
        caplog.clear()
        with caplog.at_level(logging.WARNING, "smp_planner.library.allowed_collisions"):
            scene = PlanningScene.load(path, robot=robot)
        return scene, [record.getMessage() for record in caplog.records]

    return loaded


def pair(*names):
    return frozenset(names)


def kept_apart(robot):
    """Return the pairs of links of which spheres must stay clear of each other."""
    model = SMP.fit(swings(), robot=robot).robot.model
    return {frozenset(names) for names in np.array(robot.bodies)[model.collision_pairs].tolist()}


def test_pairs_of_links_are_not_kept_apart(load, kuka):
    scene, said = load([[LINKS[0], LINKS[3]], [LINKS[7], LINKS[2]]], [LINKS[4]])
    assert not said
    allowed = {pair(LINKS[0], LINKS[3]), pair(LINKS[7], LINKS[2])}
    assert scene.robot.touching == allowed
    assert kept_apart(scene.robot) == kept_apart(kuka) - allowed
    assert len(scene.obstacles) == 2


def test_what_is_held_is_in_the_matrix_by_its_name(load, kuka):
    touching = [["rod", LINKS[2]], ["rod", LINKS[6]]]
    scene, said = load(touching, held=[ROD])
    plain, _ = load(held=[ROD])
    assert not said
    left = kept_apart(plain.robot) - kept_apart(scene.robot)
    assert left == {frozenset(names) for names in touching}


def test_defaults_hold_for_all_links_without_an_entry(load, kuka):
    """And add to what may touch already."""
    before = {pair(LINKS[0], LINKS[2])}
    told = Robot.from_urdf(KUKA, LINKS[7], overshoot=0.04, touching=[(LINKS[0], LINKS[2])])
    scene, said = load(others=[LINKS[7], LINKS[1]], robot=told, **{LINKS[7]: True})
    free = [other for other in LINKS[:7] if other != LINKS[1]]
    assert scene.robot.touching == before | {pair(LINKS[7], other) for other in free}
    # The link may touch both objects, too, but only this one.
    assert [(LINKS[7] in line, "plans keep them clear" in line) for line in said] == [
        (True, True)
    ] * 2


def test_an_object_that_all_that_moves_may_touch_is_no_obstacle(load, middle):
    through, said = load([["ball", link] for link in MOVING], [LINKS[0]])
    assert through.names == ("shelf",)
    assert said == ["ball is no obstacle: allowed_collision_matrix lets all that moves touch it"]
    around, said = load([["ball", link] for link in MOVING[:-1]])
    assert around.names == ("ball", "shelf")
    (line,) = said
    assert LINKS[6] in line
    assert LINKS[7] not in line
    client = BulletClient(pybullet.DIRECT)
    try:
        body = client.loadURDF(KUKA, useFixedBase=True)
        shape = client.createCollisionShape(client.GEOM_SPHERE, radius=0.06)
        ball = client.createMultiBody(0.0, shape, -1, middle)
        clear = []
        for scene in (through, around):
            arm = SMP.fit(swings(), robot=scene.robot)
            ends = arm.demonstrations[0][[0, -1]]
            plan = arm.adapt(scene.obstacles, start=ends[0], goal=ends[1], particles=12)
            assert plan.good.any()
            touches = 0
            for configuration in plan.trajectories[plan.good][:, ::8].reshape(-1, 7):
                for joint, angle in enumerate(configuration):
                    client.resetJointState(body, joint, angle)
                touches += bool(client.getClosestPoints(body, ball, 0.0))
            clear.append(touches == 0)
        assert clear == [False, True]
    finally:
        client.disconnect()


def test_what_is_held_counts_among_what_moves(load):
    pairs = [["ball", link] for link in MOVING]
    scene, said = load(pairs, held=[ROD])
    assert scene.names == ("ball", "shelf")
    assert len(said) == 1
    scene, said = load([*pairs, ["ball", "rod"]], held=[ROD])
    assert scene.names == ("shelf",)


def test_links_that_stand_still_and_objects_among_themselves_say_nothing(load):
    scene, said = load([["ball", LINKS[0]], ["ball", "shelf"]])
    assert scene.names == ("ball", "shelf")
    assert not said


def test_a_default_of_an_object_lets_it_pass(load):
    scene, said = load(ball=True)
    assert scene.names == ("shelf",)
    assert len(said) == 1
    # An entry of its own goes first.
    scene, said = load(others=["ball", LINKS[3]], ball=True)
    assert scene.names == ("ball", "shelf")
    assert LINKS[3] not in said[0]


def test_names_that_are_of_nothing_are_told(load):
    scene, said = load([["gripper", LINKS[1]], ["camera", "cart"]], ["nothing"])
    assert scene.robot.touching == frozenset()
    assert said == [
        "allowed_collision_matrix lets camera, cart, gripper touch something, but there are no "
        "bodies of these names"
    ]


def test_without_a_robot_the_matrix_is_told_not_to_be_used(load):
    scene, said = load([[LINKS[0], "ball"]], robot=None)
    assert scene.robot is None
    assert len(scene.obstacles) == 2
    (line,) = said
    assert line.startswith("allowed_collision_matrix is not used: give robot=")
    assert line.endswith(f"(ball, {LINKS[0]})")
    _, said = load([], ["ball", LINKS[0]], robot=None)
    assert not said


def test_a_robot_that_does_not_know_its_links_is_told_of(load, kuka):
    """Such as those of files that were saved before spheres had names."""
    nameless = replace(kuka, bodies=())
    scene, said = load([["ball", link] for link in LINKS], robot=nameless)
    assert scene.robot.touching == frozenset()
    assert scene.names == ("ball", "shelf")
    assert said == [
        "allowed_collision_matrix is not used: the robot does not know the links of its spheres"
    ]
    assert not load(robot=nameless)[1]


def test_wrong_matrices_name_the_file(kuka, tmp_path):
    path = tmp_path / "scene.yaml"
    matrix = {"entry_names": ["a", "b"], "entry_values": [[0, 0]]}
    path.write_text(json.dumps({"world": {}, "allowed_collision_matrix": matrix}))
    with pytest.raises(ValueError, match=r"scene.yaml is no scene .* a row for each of 2"):
        PlanningScene.load(path, robot=kuka)
