"""The legs of PushLiftBox's ways, and the choice of obstacles on two of them."""

import numpy as np
import pytest

from smp_gym.datasets.demonstrations import Demonstrations
from smp_gym.robot import kinematics
from smp_gym.robot.inverse_kernels import reach_points, reach_pose
from smp_gym.sampling import place_without_witness, sample_with_witness
from smp_gym.sampling.obstacles import START_CLEARANCE
from smp_gym.tasks.push_lift_box.leg_obstacles import GrowingBodies, grown
from smp_gym.tasks.push_lift_box.legs import Leg, Members
from smp_gym.tasks.push_lift_box.rules import START_CONFIGURATION, push_poses
from smp_gym.tasks.push_lift_box.scenes import CROWDS, PLACED

BLOCKED = ("easy", "medium", "hard")
NEAR = np.array(START_CONFIGURATION)


# --- Inverse kinematics from nearby ----------------------------------------------------------


def test_poses_are_reached_from_nearby():
    rng = np.random.default_rng(0)
    for _ in range(50):
        there = NEAR + rng.uniform(-0.25, 0.25, 6)
        pose = kinematics.end_effector_pose(there)
        found = reach_pose(pose, NEAR)
        np.testing.assert_allclose(kinematics.end_effector_pose(found), pose, atol=1e-6)


def test_a_pose_out_of_reach_is_an_error():
    pose = kinematics.end_effector_pose(NEAR)
    pose[0, 3] += 2.0
    with pytest.raises(kinematics.UnreachableError, match="no configuration near"):
        reach_pose(pose, NEAR)


def test_points_are_carried_to_a_place_by_about_the_shortest_way():
    rng = np.random.default_rng(1)
    point = np.array([0.02, 0.0, -0.015])
    near = NEAR + rng.uniform(-0.1, 0.1, (40, 6))
    pose = kinematics.end_effector_pose(NEAR)
    place = pose[:3, :3] @ point + pose[:3, 3] + (0.03, -0.02, 0.02)
    found = reach_points(place, point, near)
    poses = kinematics.end_effector_pose(found)
    np.testing.assert_allclose(
        poses[:, :3, :3] @ point + poses[:, :3, 3], np.tile(place, (40, 1)), atol=1e-6
    )
    # Any other solution is farther away: those next to random neighbours of the seeds.
    others = reach_points(place, point, near + rng.normal(0.0, 0.05, near.shape))
    far, away = (np.linalg.norm(q - near, axis=1) for q in (found, others))
    assert (away > 0.98 * far).all()
    assert np.isnan(reach_points(place + 3.0, point, near)).all()


# --- Legs ------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def shown():
    return Demonstrations.load("PushLiftBox").configurations


@pytest.fixture(scope="module")
def leg(shown):
    spheres = kinematics.arm_spheres()
    every = np.arange(len(spheres))
    return Leg(
        demonstrations=shown[:, :85],
        spheres=spheres,
        moving=every,
        swept=every,
        pairs=kinematics.self_collision_pairs(spheres),
        steps=199,
        stride=6,
        outline=every,
    )


def test_a_demonstration_carried_to_its_own_ends_is_itself(leg, shown):
    for number in range(7):
        own = Members(
            shown[number, 0], shown[number, None, 84], np.array([number]), np.zeros((1, 3, 6))
        )
        np.testing.assert_allclose(leg.trajectories(own)[0], shown[number, :85], atol=1e-12)


def test_members_keep_ends_and_end_velocities_whatever_the_detour(leg, shown):
    rng = np.random.default_rng(2)
    begin, ends = shown[0, 0] + 0.1, shown[:5, 84] - 0.2
    base = np.array([-1, 0, 3, 4, 6])
    plain = leg.trajectories(Members(begin, ends, base, np.zeros((5, 3, 6))))
    bent = leg.trajectories(Members(begin, ends, base, rng.normal(0.0, 0.3, (5, 3, 6))))
    for ways in (plain, bent):
        np.testing.assert_allclose(ways[:, 0], np.tile(begin, (5, 1)), atol=1e-12)
        np.testing.assert_allclose(ways[:, -1], ends, atol=1e-12)
    step = np.abs(bent - plain)
    assert step.max() > 0.1
    # Zero with its slope: one of 84 steps from an end, a detour has hardly begun.
    assert step[:, [1, -2]].max() < 0.02 * step.max()
    members = Members(begin, ends, base, rng.normal(0.0, 0.3, (5, 3, 6)))
    np.testing.assert_array_equal(leg.trajectories(members, 6), leg.trajectories(members)[:, ::6])


# --- The choice ------------------------------------------------------------------------------


def test_bodies_grow_until_they_touch_what_they_keep_from():
    """Against the closed form: a box that grows along x towards a wall at x = 0.7."""
    least, most = np.zeros((3, 9)), np.zeros((3, 9))
    for rows, half in ((least, 0.02), (most, 0.4)):
        rows[:, 1:4] = (0.5, 0.0, 0.1)
        rows[:, 4], rows[:, 6:] = 1.0, (half, 0.02, 0.02)
    most[1, 6] = 0.1
    least[2, 1] = most[2, 1] = 0.69
    rows = grown(GrowingBodies(least, most), lambda rows: rows[:, 1] + rows[:, 6] <= 0.7)
    assert len(rows) == 2, "what is too large from the first is left out"
    assert 0.2 - 0.38 / 64 <= rows[0, 6] <= 0.2
    assert rows[1, 6] == pytest.approx(0.1)


# --- Scenes ----------------------------------------------------------------------------------


def numpy_distance(points, obstacle):
    """Return signed distances (m) of (..., 3) points to an upright obstacle, outside of it."""
    _, _, s, c = obstacle.quaternion
    yaw = 2 * np.arctan2(s, c)
    turn = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    local = (points - np.array(obstacle.position)) @ turn
    if obstacle.shape == "sphere":
        return np.linalg.norm(local, axis=-1) - obstacle.size[0]
    if obstacle.shape == "cylinder":
        local = np.stack([np.hypot(local[..., 0], local[..., 1]), local[..., 2]], axis=-1)
        over = np.abs(local) - (obstacle.size[0], obstacle.size[2])
    else:
        over = np.abs(local) - obstacle.size
    return np.linalg.norm(np.maximum(over, 0.0), axis=-1) + np.minimum(over.max(axis=-1), 0.0)


@pytest.fixture(scope="module")
def spheres():
    """Spheres until the hand closes, and from then on."""
    metadata = Demonstrations.load("PushLiftBox").metadata
    arm = kinematics.arm_spheres()
    return (
        kinematics.concatenate(arm, kinematics.finger_spheres(np.zeros(4))),
        kinematics.concatenate(
            arm,
            kinematics.finger_spheres(metadata["finger_angles"]),
            kinematics.box_spheres((0.025, 0.025, 0.03), metadata["object_in_hand"]),
        ),
    )


def clearance(way, obstacles, spheres, grasp):
    """Return the least distance of a (T, 6) way's moving spheres to obstacles, by plain numpy."""
    least = np.inf
    for part, body in ((way[: grasp + 1], spheres[0]), (way[grasp:], spheres[1])):
        moving = body.link >= 2
        centers = kinematics.sphere_centers(part, body)[:, moving]
        for obstacle in obstacles:
            gap = numpy_distance(centers, obstacle) - body.radius[moving]
            least = min(least, gap.min())
    return least


def mean_way(mean, scene, push, lifted, samples):
    """Return the mean demonstration (200, 6) carried to start, ends of the push, and lifted end."""
    begin, end = samples
    way = mean.copy()
    for first, last, ends in (
        (0, begin, (np.array(scene.start), push[0])),
        (end, 199, (push[1], lifted)),
    ):
        share = np.linspace(0.0, 1.0, last - first + 1)[:, None]
        blend = share**3 * (10 - 15 * share + 6 * share**2)
        part = mean[first : last + 1]
        way[first : last + 1] = (
            part + (1 - blend) * (ends[0] - part[0]) + blend * (ends[1] - part[-1])
        )
    return way


@pytest.mark.parametrize("difficulty", BLOCKED)
def test_the_witness_keeps_its_clearance_and_the_mean_way_is_blocked(difficulty, shown, spheres):
    metadata = Demonstrations.load("PushLiftBox").metadata
    begin, end = metadata["push_samples"]
    held = np.array(metadata["object_in_hand"])[:3, 3]
    mean = shown.mean(axis=0)
    for seed in range(6):
        scene, witness = sample_with_witness("PushLiftBox", difficulty, seed)
        pose = kinematics.end_effector_pose(witness)
        np.testing.assert_allclose(witness[0], scene.start)
        np.testing.assert_allclose(
            pose[-1, :3, :3] @ held + pose[-1, :3, 3], scene.goals[0].position, atol=1e-6
        )
        box = scene.manipulated
        ends = push_poses(np.array(box.position), box.yaw, np.array([0.0, 1.0]))
        np.testing.assert_allclose(pose[[begin, end]], ends, atol=1e-6)
        enough = CROWDS[difficulty][0]
        assert clearance(witness, scene.obstacles, spheres, end) >= enough - 1e-9
        assert (np.abs(np.diff(witness, axis=0)) * 199 / kinematics.JOINT_VELOCITY).max() <= 14.0

        lifted = reach_points(np.array(scene.goals[0].position), held, mean[None, -1])[0]
        way = mean_way(mean, scene, witness[[begin, end]], lifted, (begin, end))
        way[begin : end + 1] = witness[begin : end + 1]
        assert clearance(way, scene.obstacles, spheres, end) < -0.01


@pytest.mark.parametrize("difficulty", BLOCKED)
def test_without_a_witness_the_mean_way_is_blocked_and_what_all_share_is_free(
    difficulty, shown, spheres
):
    metadata = Demonstrations.load("PushLiftBox").metadata
    begin, end = metadata["push_samples"]
    held = np.array(metadata["object_in_hand"])[:3, 3]
    mean = shown.mean(axis=0)
    for seed in range(6):
        scene = place_without_witness("PushLiftBox", difficulty, seed)
        assert len(scene.obstacles) == PLACED[difficulty][0]
        box = scene.manipulated
        poses = push_poses(np.array(box.position), box.yaw, np.array([0.0, 1.0]))
        turn = np.zeros(6)
        # Demonstrated boxes stand at a bearing of about a quarter to the right.
        turn[0] = -0.25 - np.arctan2(box.position[1], box.position[0])
        behind, grasp = (
            reach_pose(pose, near + turn)
            for pose, near in zip(poses, mean[[begin, end]], strict=True)
        )
        lifted = reach_points(np.array(scene.goals[0].position), held, mean[None, -1])[0]
        way = mean_way(mean, scene, (behind, grasp), lifted, (begin, end))
        legs = [(way[: begin + 1], begin), (way[end:], 0)]
        depth = [clearance(leg, scene.obstacles, spheres, grasped) for leg, grasped in legs]
        ends = [
            clearance(way[[0, begin]], scene.obstacles, spheres, 1),
            clearance(way[[end, -1]], scene.obstacles, spheres, 0),
        ]
        assert min(depth) < -0.01
        assert min(ends) > START_CLEARANCE - 0.001
