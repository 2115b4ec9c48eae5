import sys

import gymnasium
import numpy as np
import pytest

import smp_gym  # noqa: F401
from smp_gym.datasets.motion_bench_maker import load_obstacles, load_scene
from smp_gym.sampling import sample_scene
from smp_gym.scene import MAX_OBSTACLES

pytest.importorskip("yaml", reason="PyYAML is not installed")

SCENE = """
name: (noname)
robot_state: {joint_state: {name: [elbow], position: [0.3]}}
fixed_frame_transforms:
  - child_frame_id: world
    transform: {translation: [0, 0, 0], rotation: [0, 0, 0, 1]}
allowed_collision_matrix: {entry_names: [], entry_values: []}
world:
  collision_objects:
    - header: {frame_id: base_link}
      id: board
      primitives:
        - type: box
          dimensions: [0.3, 0.2, 0.02]
      primitive_poses:
        - position: [0.5, 0, 0.45]
          orientation: [0, 0.383, 0, 0.924]
    - header: {frame_id: base_link}
      id: can
      primitives:
        - {type: cylinder, dimensions: [0.14, 0.03]}
        - {type: SPHERE, dimensions: [4e-2]}
      primitive_poses:
        - {position: {x: 0.6, y: 0.1, z: 0.07}, orientation: {x: 0, y: 0, z: 0, w: 1}}
        - {position: [0.6, -0.1, 0.2], orientation: [0, 0, 0, 1]}
"""

ONE = """
world:
  collision_objects:
    - id: thing
      primitives: [{{type: {type}, dimensions: {dimensions}}}]
      primitive_poses: [{{position: {position}, orientation: {orientation}}}]
"""


@pytest.fixture
def write(tmp_path):
    """Return a function that writes a file and returns its path."""

    def to_file(text):
        path = tmp_path / "scene.yaml"
        path.write_text(text, encoding="utf-8")
        return path

    return to_file


def one(**changes):
    fields = {"type": "box", "dimensions": [0.1, 0.2, 0.3], "position": [0.5, 0.0, 0.4]}
    return ONE.format(**{**fields, "orientation": [0, 0, 0, 1], **changes})


def test_full_extents_become_half_extents(write):
    board, can, ball = load_obstacles(write(SCENE))
    assert (board.shape, can.shape, ball.shape) == ("box", "cylinder", "sphere")
    assert board.size == pytest.approx((0.15, 0.10, 0.01))
    assert can.size == pytest.approx((0.03, 0.03, 0.07))
    assert ball.size == pytest.approx((0.04, 0.04, 0.04))
    assert can.position == pytest.approx((0.6, 0.1, 0.07))
    norm = np.hypot(0.383, 0.924)
    assert board.quaternion == pytest.approx((0.0, 0.383 / norm, 0.0, 0.924 / norm))


def test_frames_are_turned_then_moved(write):
    path = write(one(position=[0.5, 0.1, 0.4]))
    (body,) = load_obstacles(path, offset=(0.1, -0.2, -0.3), yaw=np.pi / 2)
    assert body.position == pytest.approx((0.1 - 0.1, -0.2 + 0.5, 0.1))
    half = np.sqrt(0.5)
    assert body.quaternion == pytest.approx((0.0, 0.0, half, half))


def test_the_pose_of_an_object_comes_before_those_of_its_primitives(write):
    turned = "pose: {position: [0.5, 0, 0.1], orientation: [0, 0, 0.70710678, 0.70710678]}\n"
    text = one(position=[0.2, 0.0, 0.3]).replace(
        "      primitives", f"      {turned}      primitives"
    )
    (body,) = load_obstacles(write(text))
    assert body.position == pytest.approx((0.5, 0.2, 0.4))


def test_what_nothing_can_touch_is_left_out(write):
    path = write(one(position=[0.5, 0.0, -0.4]))
    assert load_obstacles(path) == ()
    assert len(load_obstacles(path, offset=(0.0, 0.0, 0.5))) == 1
    assert load_obstacles(path, offset=(1.5, 0.0, 0.5)) == ()


def test_a_scene_without_objects_is_empty(write):
    assert load_obstacles(write("world: {collision_objects: []}")) == ()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a: [1, 2", "not YAML"),
        ("!!python/object/apply:os.getcwd []", "not YAML"),
        ("", "the file must be a mapping, got None"),
        ("just text", "the file must be a mapping, got 'just text'"),
        ("name: empty", "world must be a mapping, got None"),
        ("world: {collision_objects: 3}", "collision_objects must be a list, got 3"),
        ("world: {collision_objects: [7]}", r"collision_objects\[0\] must be a mapping, got 7"),
        (one(type="pyramid"), r"thing.primitives\[0\].type must be one of box, .* got 'pyramid'"),
        (one(dimensions="[0.1, 0.2]"), "dimensions of a box must be 3 numbers"),
        (one(dimensions="~"), r"dimensions of a box must be 3 numbers, got \[\]"),
        (one(dimensions="[.nan, 0.2, 0.1]"), "dimensions must hold finite numbers, got nan"),
        (one(dimensions="[wide, 0.2, 0.1]"), "dimensions must hold finite numbers, got 'wide'"),
        (one(dimensions="[true, 0.2, 0.1]"), "dimensions must hold finite numbers, got True"),
        (one(dimensions="[0.1, -0.2, 0.1]"), "dimensions must be positive"),
        (one(type="cylinder", dimensions="[0.1, 0]"), "dimensions must be positive"),
        (one(position="[0.1, 0.2]"), r"position must be \[x, y, z\]"),
        (one(position="[.inf, 0, 0]"), "position must hold finite numbers, got inf"),
        (one(orientation="[0, 0, 0, 0]"), "orientation must have norm 1"),
        (one(orientation="{x: 0, y: 0, z: 0}"), "orientation must be"),
        (one(type="cone", dimensions="[0.1, 0.2]"), "a cone, .* skip_unsupported=True"),
        (one(dimensions="[0.1, 0.2, 9.0]"), "thing must have .* within 2.0 m"),
        (one().replace("id: thing", "id: thing\n      operation: remove"), "thing.operation"),
        (
            one().replace("id: thing", "id: thing\n      meshes: [{resource: a.stl}]"),
            r"thing.meshes\[0\] is a mesh, .* skip_unsupported=True",
        ),
        (one().replace("world:", "world:\n  octomap: {origin: {}}"), "world has an octomap"),
        (one().replace("primitive_poses: [", "primitive_poses: [{}, "), "a pose for each of its 1"),
        (SCENE.replace("base_link", "odom", 1), "one frame, got base_link, odom"),
    ],
)
def test_damaged_files_are_refused_with_what_is_wrong(write, text, message):
    path = write(text)
    with pytest.raises(ValueError, match=message) as caught:
        load_obstacles(path)
    assert str(path) in str(caught.value)


def test_what_cannot_be_an_obstacle_may_be_skipped(write):
    text = one(type="cone", dimensions="[0.1, 0.2]")
    text = text.replace("id: thing", "id: thing\n      meshes: [{resource: a.stl}]")
    path = write(text + one().replace("\nworld:\n  collision_objects:\n", ""))
    (body,) = load_obstacles(path, skip_unsupported=True)
    assert body.shape == "box"


@pytest.mark.parametrize(("extra", "fits"), [(0, True), (1, False)])
def test_there_may_be_no_more_than_an_observation_holds(write, extra, fits):
    count = MAX_OBSTACLES + extra
    entry = one().replace("\nworld:\n  collision_objects:\n", "")
    path = write("world:\n  collision_objects:\n" + entry * count)
    if fits:
        assert len(load_obstacles(path)) == count
    else:
        with pytest.raises(ValueError, match=f"at most {MAX_OBSTACLES} bodies .* got {count}"):
            load_obstacles(path)


@pytest.mark.parametrize("offset", [(0.0, 0.0), (0.0, 0.0, float("nan"))])
def test_a_bad_offset_is_named(write, offset):
    with pytest.raises(ValueError, match="offset must"):
        load_obstacles(write(SCENE), offset=offset)


def test_a_missing_file_is_an_os_error(tmp_path):
    with pytest.raises(FileNotFoundError):
        load_obstacles(tmp_path / "none.yaml")


def test_without_pyyaml_the_error_says_what_to_install(write, monkeypatch):
    monkeypatch.setitem(sys.modules, "yaml", None)
    with pytest.raises(ImportError, match=r'pip install "smp-gym\[motion-bench-maker\]"'):
        load_obstacles(write(SCENE))


def test_a_scene_is_played(write):
    path = write(one(position=[0.45, 0.05, 0.1], orientation=[0.0, 0.383, 0.0, 0.924]))
    scene = load_scene(path, "Placement", 3)
    bare = sample_scene("Placement", "none", 3)
    assert (scene.start, scene.goals) == (bare.start, bare.goals)
    assert scene.obstacles == load_obstacles(path)
    assert (scene.difficulty, scene.seed) == ("custom", None)
    env = gymnasium.make("smp_gym/Placement-v0")
    try:
        observation, info = env.reset(options={"scene": scene})
        assert env.observation_space.contains(observation)
        assert not info["collided"]
    finally:
        env.close()


def test_a_goal_in_the_way_of_the_furniture_is_an_error(write):
    x, y, _ = sample_scene("Placement", "none", 0).goals[0].position
    path = write(one(position=[x, y, 0.05]))
    with pytest.raises(ValueError, match=r"obstacle 0, a box at .* stands in the bin at"):
        load_scene(path)


def test_only_tasks_that_set_an_object_down_have_such_scenes(write):
    with pytest.raises(ValueError, match=r"task must be one of Placement, .* got 'DrawS'"):
        load_scene(write(SCENE), "DrawS")
