"""Grasping: learned from demonstrations, posed as a problem, planned and executed."""

from dataclasses import replace

import numpy as np
import pytest

from smp_gym.datasets.demonstrations import Demonstrations
from smp_gym.env import ManipulationEnv
from smp_gym.observation import CONTROL_PERIOD, decode
from smp_gym.robot.kinematics import JOINT_VELOCITY, arm_spheres, end_effector_pose
from smp_gym.scene import TABLE, Goal, Obstacle
from smp_gym.tasks.push_lift_box.rules import HAND_HEIGHT, OBJECT_BEHIND, PUSH_LENGTH
from smp_planner.planners import make_planner
from smp_planner.planning.assessment import assess
from smp_planner.planning.problem import arm_stage
from smp_planner.planning.tool_constraints import Poses
from smp_planner.planning.tool_goals import ViaPose
from smp_planner.policy.grasping import learn_grasping
from smp_planner.policy.observed_problem import problem_from
from smp_planner.policy.planner_policy import PlannerPolicy
from smp_planner.policy.tracking import CLOSING_STEPS, GripperEvent, Track


@pytest.fixture(scope="module")
def shipped():
    return Demonstrations.load("PushLiftBox")


@pytest.fixture(scope="module")
def env():
    made = ManipulationEnv("PushLiftBox", "none")
    yield made
    made.close()


@pytest.fixture(scope="module")
def posed(env, shipped):
    observation, _ = env.reset(seed=0)
    decoded = decode(observation, "PushLiftBox")
    return decoded, problem_from(decoded, 0, grasping=learn_grasping(shipped))


def test_the_grasp_is_learned_relative_to_the_object(shipped):
    grasping = learn_grasping(shipped)
    begin, end = shipped.metadata["push_samples"]
    last = shipped.configurations.shape[1] - 1
    assert grasping.phase == pytest.approx(end / last)
    # The hand comes to rest behind the box: shortly before, the demonstrations agree already.
    assert begin / last - 0.1 < grasping.phases[0] <= begin / last
    expected = (OBJECT_BEHIND + PUSH_LENGTH, 0.0, HAND_HEIGHT - 0.03)
    np.testing.assert_allclose(grasping.poses[-1, :3, 3], expected, atol=1e-3)
    turns = grasping.poses[:, :3, :3]
    np.testing.assert_allclose(
        turns @ turns.swapaxes(1, 2), np.tile(np.eye(3), (5, 1, 1)), atol=1e-9
    )


def test_a_task_that_begins_with_the_object_in_the_hand_has_no_grasp():
    assert learn_grasping(Demonstrations.load("Placement")) is None


def test_demonstrations_that_disagree_about_the_grasp_are_refused(shipped):
    turned = shipped.configurations.copy()
    turned[0, :, 0] += 0.1
    with pytest.raises(ValueError, match="must agree about the hand's pose"):
        learn_grasping(replace(shipped, configurations=turned))
    with pytest.raises(ValueError, match="missing: finger_angles, object_in_hand"):
        learn_grasping(replace(shipped, metadata={}))


def test_the_problem_needs_the_grasp(posed):
    with pytest.raises(ValueError, match="grasping must be given"):
        problem_from(posed[0], 0)


def test_stages_tell_when_the_box_is_an_obstacle_and_when_it_is_carried(posed):
    decoded, problem = posed
    approach, push, lift, carried = problem.stages
    assert (approach.first, approach.last) == (0.0, push.first)
    assert push.last == lift.first == carried.first
    assert lift.last == carried.last == 1.0
    here = tuple(decoded.object.position.tolist())
    assert [body.position == here for body in approach.obstacles].count(True) == 1
    assert not any(body.position == here for body in (*push.obstacles, *lift.obstacles))
    # What is carried stands on the table when it is lifted.
    assert TABLE in lift.obstacles
    assert TABLE not in carried.obstacles


@pytest.mark.parametrize(
    ("first", "last", "count", "steps"),
    [(0.0, 1.0, 50, (0, 50)), (0.0, 0.5, 5, (0, 3)), (0.5, 1.0, 5, (2, 5)), (0.4, 0.6, 5, (1, 4))],
)
def test_the_steps_of_a_stage_cover_it(first, last, count, steps):
    stage = arm_stage(first, last, arm_spheres(), ())
    assert stage.steps(count) == slice(*steps)


def test_bad_stages_and_via_poses_are_refused():
    with pytest.raises(ValueError, match="must lie in"):
        arm_stage(0.5, 0.5, arm_spheres(), ())
    with pytest.raises(ValueError, match=r"phase must be .* at most 1.0, got 1.2"):
        ViaPose(1.2, np.eye(4))
    with pytest.raises(ValueError, match=r"pose must have shape \(4, 4\), got \(3,\)"):
        ViaPose(0.2, np.zeros(3))


def test_plans_pass_the_via_poses(posed):
    _, problem = posed
    plan = make_planner("promp", "PushLiftBox").plan([problem])[0]
    last = plan.trajectories.shape[1] - 1
    for via in problem.via_poses:
        hands = end_effector_pose(plan.trajectories[:, round(via.phase * last)])
        assert np.linalg.norm(hands[:, :3, 3] - via.pose[:3, 3], axis=1).max() < 0.01
    assert plan.good.any()


def test_a_trajectory_past_the_via_poses_does_not_meet_the_constraints(posed):
    _, problem = posed
    planner = make_planner("promp", "PushLiftBox")
    (plan,) = planner.plan([problem])
    (taken,) = plan.trajectories[[plan.chosen]]
    straight = np.linspace(taken[0], taken[-1], len(taken))
    bent, turned = taken.copy(), taken.copy()
    due = round(problem.via_poses[2].phase * (len(taken) - 1))
    bent[due, 0] += 0.05  # moves the hand by centimetres
    turned[due, -1] += 0.3  # turns it about its own axis, and moves it not at all
    paths = np.stack([taken, straight, bent, turned])
    (poses,) = (each for each in problem.constraints if isinstance(each, Poses))
    frame = np.concatenate([np.eye(3) * 0.1, np.zeros((3, 1))], axis=1)
    away = [
        np.linalg.norm((pose - via.pose)[:3, :3] @ frame + (pose - via.pose)[:3, 3:], axis=0).max()
        for via in problem.via_poses
        for pose in end_effector_pose(paths[:, round(via.phase * (len(taken) - 1))])
    ]
    expected = np.reshape(away, (-1, len(paths))).max(axis=0) - 0.02
    assert poses.missed(paths) == pytest.approx(expected, abs=1e-9)
    verdict = assess(problem, paths, planner.plan_settings)
    assert verdict.passing.tolist() == [True, False, False, False]
    assert not verdict.good[1:].any()


def test_an_obstacle_in_the_way_of_the_carried_box_alone_is_seen(posed):
    _, problem = posed
    planner = make_planner("promp", "PushLiftBox")
    free = planner.plan([problem])[0]
    assert free.collision_free[free.chosen]
    # Under the box at the end of the lift, nearer to it than to the hand.
    x, y, z = problem.goals[0].center
    block = Obstacle(shape="box", position=(x, y, z - 0.07), size=(0.03, 0.03, 0.04))
    stages = tuple(replace(s, obstacles=(*s.obstacles, block)) for s in problem.stages)
    hit = planner.plan([replace(problem, stages=stages)])[0]
    assert not hit.collision_free.any()
    hand_only = planner.plan([replace(problem, stages=stages[:3])])[0]
    assert hand_only.clearance.max() > hit.clearance.max()


def test_the_arm_stands_still_while_the_hand_closes():
    trajectory = np.linspace(0.0, 1.0, 101)[:, None] * np.full(6, 0.5)
    track = Track(trajectory, 10.0, GripperEvent(phase=0.5, command=1.0))
    reference, positions, commands = trajectory[0].copy(), [], []
    for step in range(240):
        action = track.action(step, reference).astype(np.float64)
        reference = reference + action[:6] * JOINT_VELOCITY * CONTROL_PERIOD
        positions.append(reference[0])
        commands.append(action[6])
    positions, commands = np.array(positions), np.array(commands)
    closing = int(np.argmax(commands > 0.0))
    still = np.diff(positions[closing - 1 : closing + CLOSING_STEPS])
    np.testing.assert_allclose(still, 0.0, atol=1e-6)
    assert (commands[closing:] == 1.0).all()
    assert (commands[:closing] == -1.0).all()
    assert positions[closing] == pytest.approx(0.25, abs=1e-5)
    # As late at the end as it stood still.
    arrived = int(np.argmax(positions > 0.5 - 1e-6)) + 1
    assert arrived == pytest.approx(10.0 / CONTROL_PERIOD + CLOSING_STEPS, abs=1)


def test_an_event_at_the_end_holds_nothing_up():
    trajectory = np.linspace(0.0, 1.0, 101)[:, None] * np.full(6, 0.5)
    for event in (None, GripperEvent(1.0, -1.0), GripperEvent(0.5, -1.0)):
        track = Track(trajectory, 10.0, event)
        moves = [track.action(step, track.reference(step * CONTROL_PERIOD)) for step in range(200)]
        assert np.ptp([move[0] for move in moves]) < 1e-5


@pytest.mark.parametrize(
    ("method", "difficulty", "seed"), [("promp", "none", 0), ("smp", "easy", 0)]
)
def test_a_policy_pushes_grasps_and_lifts(method, difficulty, seed):
    made = ManipulationEnv("PushLiftBox", difficulty)
    policy = PlannerPolicy.make(method, "PushLiftBox")
    observation, _ = made.reset(seed=seed)
    state, terminated, info = None, False, {}
    while not terminated and not info.get("failure"):
        action, state = policy.predict(observation, state, deterministic=True)
        observation, _, terminated, _, info = made.step(action)
    assert info["is_success"], info
    made.close()


def test_targets_out_of_reach_are_a_clear_error(posed, shipped):
    decoded = posed[0]
    goals = (Goal(kind="lift", position=(1.5, 0.0, 0.5)),)
    far = replace(decoded, scene=decoded.scene.model_copy(update={"goals": goals}))
    problem = problem_from(far, 0, grasping=learn_grasping(shipped))
    with pytest.raises(ValueError, match="out of reach"):
        make_planner("promp", "PushLiftBox").plan([problem])
