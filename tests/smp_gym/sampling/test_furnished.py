import json
import os
import subprocess
import sys

import gymnasium
import numpy as np
import pybullet
import pytest

import smp_gym  # noqa: F401
from smp_gym.datasets.demonstrations import Demonstrations
from smp_gym.env import ManipulationEnv
from smp_gym.robot import kinematics
from smp_gym.rollout import play
from smp_gym.sampling import CROWDED, sample_scene, sample_with_witness
from smp_gym.sampling.furnished import TIGHTNESS
from smp_gym.sampling.furniture import FURNITURE
from smp_gym.scene import MAX_OBSTACLES, Scene
from smp_gym.tasks.placing import GRASP_FINGER_ANGLES
from smp_gym.tasks.registry import task_definition

TASKS = ("Placement", "DoubleSidedPlacement")
CASES = [(task, kind) for task in TASKS for kind in FURNITURE]
SEEDS = {"easy": (0,), "medium": (0,), "hard": (0, 1)}

GATE = {"shelf": (0, 1), "box": (5, 6), "cage": (0, 2), "table": (1, 2)}
"""Which two parts of a piece the hand must pass between; a box's flaps come after its lid."""

GAPS = {"easy": 0.060, "medium": 0.040, "hard": 0.025}


@pytest.fixture(scope="module")
def drawn():
    """Furnished scenes with witnesses of each task, kind and difficulty."""
    return {
        (task, kind, difficulty, seed): sample_with_witness(task, difficulty, seed, kind)
        for task, kind in CASES
        for difficulty, seeds in SEEDS.items()
        for seed in seeds
    }


def test_a_furnished_scene_is_the_same_in_another_process(drawn):
    cases = [("Placement", "hard", 1, "shelf"), ("DoubleSidedPlacement", "easy", 0, "table")]
    code = (
        "import json, sys\n"
        "from smp_gym.sampling import sample_with_witness\n"
        "out = []\n"
        "for case in json.loads(sys.argv[1]):\n"
        "    scene, witness = sample_with_witness(*case)\n"
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
    for (task, difficulty, seed, kind), (text, witness) in zip(
        cases, json.loads(answer.stdout), strict=True
    ):
        scene, here = drawn[task, kind, difficulty, seed]
        assert scene.to_json() == text
        assert here.tobytes().hex() == witness


@pytest.mark.parametrize(("task", "kind"), CASES)
def test_scenes_are_what_their_family_says(drawn, task, kind):
    scenes = [drawn[task, kind, d, seed][0] for d, seeds in SEEDS.items() for seed in seeds]
    assert len({scene.obstacles for scene in scenes}) == len(scenes)
    assert len({scene.goals for scene in scenes}) == len(scenes)
    for (difficulty, seed), scene in zip(
        ((d, seed) for d, seeds in SEEDS.items() for seed in seeds), scenes, strict=True
    ):
        assert (scene.task, scene.family, scene.seed) == (task, kind, seed)
        assert scene.difficulty == difficulty
        assert Scene.from_json(scene.to_json()) == scene
        assert 7 * len(scene.goals) <= len(scene.obstacles) <= MAX_OBSTACLES
        assert {obstacle.shape for obstacle in scene.obstacles} <= {"box", "cylinder"}
        lowest = [body.position[2] - body.size[2] for body in scene.obstacles]
        assert min(lowest) == pytest.approx(0.0, abs=1e-9)


@pytest.fixture(scope="module")
def closest():
    """Function that returns the distance of two obstacles as Bullet measures it."""
    client = pybullet.connect(pybullet.DIRECT)

    def body(obstacle):
        if obstacle.shape == "box":
            shape = pybullet.createCollisionShape(
                pybullet.GEOM_BOX, halfExtents=obstacle.size, physicsClientId=client
            )
        else:
            shape = pybullet.createCollisionShape(
                pybullet.GEOM_CYLINDER,
                radius=obstacle.size[0],
                height=2 * obstacle.size[2],
                physicsClientId=client,
            )
        return pybullet.createMultiBody(
            0, shape, -1, obstacle.position, obstacle.quaternion, physicsClientId=client
        )

    def distance(one, other):
        pairs = pybullet.getClosestPoints(body(one), body(other), 1.0, physicsClientId=client)
        return min(pair[8] for pair in pairs)

    yield distance
    pybullet.disconnect(client)


def width_across(task, configuration, goal):
    """Return the width of hand and object, across the line from the base to a goal."""
    pose = task_definition(task).rules.object_in_hand
    arm = kinematics.arm_spheres()
    spheres = kinematics.concatenate(
        arm,
        kinematics.finger_spheres(GRASP_FINGER_ANGLES),
        kinematics.box_spheres((0.025, 0.025, 0.03), pose),
    )
    hand = spheres.link >= 5
    bearing = np.arctan2(goal[1], goal[0])
    across = np.array([-np.sin(bearing), np.cos(bearing), 0.0])
    middle = (kinematics.sphere_centers(configuration, spheres) @ across)[hand]
    radius = spheres.radius[hand]
    return (middle + radius).max() - (middle - radius).min()


@pytest.mark.parametrize(("task", "kind"), CASES)
def test_the_opening_is_as_much_wider_than_the_hand_as_its_difficulty_says(
    drawn, closest, task, kind
):
    for difficulty, seeds in SEEDS.items():
        assert TIGHTNESS[difficulty].gap == GAPS[difficulty]
        for seed in seeds:
            scene, witness = drawn[task, kind, difficulty, seed]
            pose = (
                kinematics.end_effector_pose(witness[-1])
                @ task_definition(task).rules.object_in_hand
            )
            goal = min(
                (goal.position for goal in scene.goals),
                key=lambda at: np.hypot(at[0] - pose[0, 3], at[1] - pose[1, 3]),
            )
            # The piece that the witness goes to was drawn first.
            one, other = (scene.obstacles[index] for index in GATE[kind])
            gap = closest(one, other) - width_across(task, witness[-1], goal)
            assert gap == pytest.approx(GAPS[difficulty], abs=0.003)


def test_difficulties_families_versions_and_seeds_differ():
    scenes = [
        sample_scene("Placement", "easy", 3, "cage"),
        sample_scene("Placement", "hard", 3, "cage"),
        sample_scene("Placement", "easy", 4, "cage"),
        sample_scene("Placement", "easy", 3, "cage", version=1),
        sample_scene("Placement", "easy", 3, "table"),
        sample_scene("Placement", "easy", 3),
    ]
    assert len({scene.obstacles for scene in scenes}) == len(scenes)
    assert [scene.family for scene in scenes] == ["cage"] * 4 + ["table", "obstacles"]


def test_old_scenes_are_of_single_obstacles():
    fields = json.loads(sample_scene("Placement", "none", 0).to_json())
    assert fields.pop("family") == "obstacles"
    assert Scene.from_json(json.dumps(fields)).family == "obstacles"
    with pytest.raises(ValueError, match="family"):
        Scene.from_json(json.dumps({**fields, "family": "wardrobe"}))


@pytest.fixture(scope="module")
def environments():
    made = {task: gymnasium.make(f"smp_gym/{task}-v0") for task in TASKS}
    yield made
    for env in made.values():
        env.close()


@pytest.mark.parametrize(("task", "kind"), CASES)
def test_witnesses_succeed_in_the_physics(drawn, environments, task, kind):
    # Difficulties differ in the width of the gap: of the second task, the extremes are played.
    difficulties = CROWDED if task == TASKS[0] else (CROWDED[0], CROWDED[-1])
    for difficulty in difficulties:
        for seed in SEEDS[difficulty]:
            scene, witness = drawn[task, kind, difficulty, seed]
            info = play(environments[task], scene, witness)
            assert info["is_success"], (difficulty, seed, info)


@pytest.mark.parametrize("kind", FURNITURE)
def test_demonstrated_trajectories_collide(drawn, environments, kind):
    """The demonstration that ends nearest to the bin, led to it, does not get through."""
    demonstrations = Demonstrations.load("Placement").configurations
    blend = np.linspace(0.0, 1.0, demonstrations.shape[1])[:, None]
    ends = kinematics.end_effector_pose(demonstrations[:, -1])[:, :2, 3]
    for seed in SEEDS["hard"]:
        scene, witness = drawn["Placement", kind, "hard", seed]
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
    ("kind", "opened"),
    [("shelf", {"front"}), ("box", {"up"}), ("cage", {"front", "up"}), ("table", {"front"})],
)
def test_furniture_opens_where_it_should(drawn, kind, opened):
    """Seen from 12 cm over the bin's floor, the front is towards the robot."""
    scene, _ = drawn["Placement", kind, "easy", 0]
    x, y, z = scene.goals[0].position
    c, s = np.cos(np.arctan2(y, x)), np.sin(np.arctan2(y, x))
    rays = {"front": (-c, -s, 0), "up": (0, 0, 1)}
    if kind in ("shelf", "box"):
        rays |= {"back": (c, s, 0), "left": (-s, c, 0), "right": (s, -c, 0)}
    for name, ray in rays.items():
        if (kind, name) == ("box", "front"):
            # The front wall is as high as the hand allows.
            continue
        assert hits(scene.obstacles, (x, y, z + 0.12), ray, 0.35) == (name not in opened), name


@pytest.mark.parametrize("kind", FURNITURE)
def test_an_environment_plays_a_family(kind):
    env = ManipulationEnv("Placement", difficulty="medium", family=kind)
    try:
        _, info = env.reset(seed=1)
        assert env.scene == sample_scene("Placement", "medium", 1, kind)
        assert (info["family"], info["seed"]) == (kind, 1)
    finally:
        env.close()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("DrawS", "easy", 0, "shelf"), "family of DrawS must be one of .* got 'shelf'"),
        (("Juggling", "easy", 0, "shelf"), "task must be one of .* got 'Juggling'"),
        (("Placement", "easy", 0, "wardrobe"), "family of Placement must be .* got 'wardrobe'"),
        (
            ("Placement", "none", 0, "shelf"),
            f"difficulty of shelf must be one of {', '.join(CROWDED)}; got 'none'",
        ),
        (("Placement", "easy", -1, "shelf"), "seed must be a whole number .* got -1"),
        (("Placement", "easy", 0, "shelf", -3), "version must be a whole number .* got -3"),
    ],
)
def test_bad_arguments_are_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        sample_scene(*arguments)


@pytest.mark.parametrize("family", ["wardrobe", "shelf"])
def test_an_environment_names_a_bad_family(family):
    with pytest.raises(ValueError, match=f"family of DrawS must be one of .* got '{family}'"):
        ManipulationEnv("DrawS", difficulty="easy", family=family)
