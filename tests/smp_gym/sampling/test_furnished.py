import json
import os
import subprocess
import sys

import gymnasium
import numpy as np
import pytest

import smp_gym  # noqa: F401
from smp_gym.datasets.demonstrations import Demonstrations
from smp_gym.env import ManipulationEnv
from smp_gym.robot import kinematics
from smp_gym.rollout import play
from smp_gym.sampling import (
    sample_furniture,
    sample_furniture_with_witness,
    sample_of_family,
    sample_scene,
)
from smp_gym.sampling.furniture import FURNITURE, Place, draw_furniture
from smp_gym.scene import FAMILIES, FURNISHED_TASKS, MAX_OBSTACLES, Scene

CASES = [(task, kind) for task in FURNISHED_TASKS for kind in FURNITURE]


@pytest.fixture(scope="module")
def drawn():
    """Two furnished scenes with witnesses of each task and kind."""
    return {
        (task, kind): [sample_furniture_with_witness(task, kind, seed) for seed in (0, 1)]
        for task, kind in CASES
    }


def test_a_furnished_scene_is_the_same_in_another_process(drawn):
    cases = [("Placement", "shelf", 1), ("DoubleSidedPlacement", "table", 0)]
    code = (
        "import json, sys\n"
        "from smp_gym.sampling import sample_furniture_with_witness\n"
        "out = []\n"
        "for case in json.loads(sys.argv[1]):\n"
        "    scene, witness = sample_furniture_with_witness(*case)\n"
        "    out.append([scene.to_json(), witness.tobytes().hex()])\n"
        "print(json.dumps(out))\n"
    )
    answer = subprocess.run(
        [sys.executable, "-c", code, json.dumps(cases)],
        env={**os.environ, "OMP_NUM_THREADS": "2", "PYTHONHASHSEED": "5"},
        capture_output=True,
        text=True,
        check=True,
    )
    for (task, kind, seed), (text, witness) in zip(cases, json.loads(answer.stdout), strict=True):
        scene, here = drawn[task, kind][seed]
        assert scene.to_json() == text
        assert here.tobytes().hex() == witness


@pytest.mark.parametrize(("task", "kind"), CASES)
def test_scenes_are_what_their_family_says(drawn, task, kind):
    first, second = (scene for scene, _ in drawn[task, kind])
    assert first.obstacles != second.obstacles
    assert first.goals != second.goals
    for seed, scene in enumerate((first, second)):
        assert (scene.task, scene.family, scene.seed) == (task, kind, seed)
        assert scene.difficulty == "custom"
        assert Scene.from_json(scene.to_json()) == scene
        assert 4 <= len(scene.obstacles) <= MAX_OBSTACLES
        assert {obstacle.shape for obstacle in scene.obstacles} <= {"box", "cylinder"}
        lowest = [body.position[2] - body.size[2] for body in scene.obstacles]
        assert min(lowest) == pytest.approx(0.0, abs=1e-9)


def test_families_versions_and_seeds_differ():
    scenes = [
        sample_furniture("Placement", "cage", 3),
        sample_furniture("Placement", "cage", 4),
        sample_furniture("Placement", "cage", 3, version=1),
        sample_furniture("Placement", "table", 3),
        sample_scene("Placement", "medium", 3),
    ]
    assert len({scene.obstacles for scene in scenes}) == len(scenes)
    assert [scene.family for scene in scenes] == ["cage"] * 3 + ["table", "obstacles"]


def test_old_scenes_are_of_single_obstacles():
    fields = json.loads(sample_scene("Placement", "none", 0).to_json())
    assert fields.pop("family") == "obstacles"
    assert Scene.from_json(json.dumps(fields)).family == "obstacles"
    with pytest.raises(ValueError, match="family"):
        Scene.from_json(json.dumps({**fields, "family": "wardrobe"}))


@pytest.fixture(scope="module")
def environments():
    made = {task: gymnasium.make(f"smp_gym/{task}-v0") for task in FURNISHED_TASKS}
    yield made
    for env in made.values():
        env.close()


@pytest.mark.parametrize(("task", "kind"), CASES)
def test_witnesses_succeed_in_the_physics(drawn, environments, task, kind):
    for scene, witness in drawn[task, kind]:
        info = play(environments[task], scene, witness)
        assert info["is_success"], info
        assert info["clearance"] >= 0.02


@pytest.mark.parametrize("kind", FURNITURE)
def test_demonstrated_ways_collide(drawn, environments, kind):
    """The demonstration that ends nearest to the bin, led to it, does not get through."""
    demonstrations = Demonstrations.load("Placement").configurations
    blend = np.linspace(0.0, 1.0, demonstrations.shape[1])[:, None]
    ends = kinematics.end_effector_pose(demonstrations[:, -1])[:, :2, 3]
    for scene, witness in drawn["Placement", kind]:
        end = kinematics.end_effector_pose(witness[-1])[:2, 3]
        shown = demonstrations[np.linalg.norm(ends - end, axis=1).argmin()]
        led = shown + (1 - blend) * (scene.start - shown[0]) + blend * (witness[-1] - shown[-1])
        info = play(environments["Placement"], scene, led)
        assert info["collided"]
        assert any(name.startswith("obstacle") for name in info["collision"])


def inside(body, point):
    """Return whether a point lies in or on an upright box or cylinder."""
    _, _, z, w = body.quaternion
    turn = -2 * np.arctan2(z, w)
    x, y, up = np.subtract(point, body.position)
    u, v = np.cos(turn) * x - np.sin(turn) * y, np.sin(turn) * x + np.cos(turn) * y
    flat = np.hypot(u, v) <= body.size[0]
    if body.shape == "box":
        flat = abs(u) <= body.size[0] and abs(v) <= body.size[1]
    return flat and abs(up) <= body.size[2]


def hits(bodies, origin, direction, length):
    """Return whether a ray meets a body."""
    steps = np.arange(0.0, length, 0.005)[:, None]
    points = np.asarray(origin) + steps * np.asarray(direction)
    return any(inside(body, point) for point in points for body in bodies)


@pytest.mark.parametrize(
    ("kind", "open_ways"),
    [("shelf", {"front"}), ("box", {"up"}), ("cage", set())],
)
def test_furniture_around_a_goal_opens_where_it_should(kind, open_ways):
    """Seen from 1 cm over the goal, away from the robot is the back, and to it the front."""
    place = Place(goal=(0.5, 0.0, 0.01), start=(0.0, 0.5, 0.3))
    origin = (0.5, 0.0, 0.02)
    ways = {"front": (-1, 0, 0), "back": (1, 0, 0), "up": (0, 0, 1), "left": (0, 1, 0)}
    for seed in range(2):
        bodies = draw_furniture(kind, place, np.random.default_rng(seed))
        if kind == "cage":
            # Bars have gaps: what matters is that they cross the sides somewhere.
            for side in (-1, 1):
                rays = [
                    hits(bodies, (0.5, 0, z), (0, side, 0), 0.4) for z in np.arange(0.1, 0.5, 0.015)
                ]
                assert any(rays)
                assert not all(rays)
            continue
        for name, way in ways.items():
            assert hits(bodies, origin, way, 0.8) == (name not in open_ways), name


@pytest.mark.parametrize("kind", FURNITURE)
def test_an_environment_plays_a_family(kind):
    env = ManipulationEnv("Placement", family=kind)
    try:
        _, info = env.reset(seed=1)
        assert env.scene == sample_furniture("Placement", kind, 1)
        assert (info["family"], info["seed"]) == (kind, 1)
    finally:
        env.close()


def test_a_family_is_chosen_by_name():
    assert sample_of_family("DrawS", "obstacles", "easy", 2) == sample_scene("DrawS", "easy", 2)
    furnished = sample_of_family("Placement", "table", "easy", 1)
    assert furnished == sample_furniture("Placement", "table", 1)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("DrawS", "shelf", 0), "task must be one of Placement, .* got 'DrawS'"),
        (("Juggling", "shelf", 0), "task must be one of .* got 'Juggling'"),
        (("Placement", "wardrobe", 0), "kind must be one of shelf, .* got 'wardrobe'"),
        (("Placement", "obstacles", 0), "kind must be one of shelf, .* got 'obstacles'"),
        (("Placement", "shelf", -1), "must not be negative, got -1 and 0"),
        (("Placement", "shelf", 0, -3), "must not be negative, got 0 and -3"),
    ],
)
def test_bad_arguments_are_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        sample_furniture(*arguments)


@pytest.mark.parametrize(
    ("task", "family", "message"),
    [
        ("Placement", "wardrobe", f"must be one of {', '.join(FAMILIES)}; got 'wardrobe'"),
        ("DrawS", "shelf", "family of DrawS must be one of obstacles; got 'shelf'"),
    ],
)
def test_an_environment_names_a_bad_family(task, family, message):
    with pytest.raises(ValueError, match=message):
        ManipulationEnv(task, family=family)
