"""Motions that begin with a velocity, and robots that hold bodies."""

import numpy as np
import pybullet
import pytest
from kuka_swings import KUKA, LINKS, swings
from pybullet_utils.bullet_client import BulletClient

from smp_gym.scene import Obstacle
from smp_planner import SMP, Circle, Robot
from smp_planner.library.adapt_settings import AdaptSettings

TIP = LINKS[7]


@pytest.fixture(scope="module")
def robot():
    return Robot.from_urdf(KUKA, TIP, overshoot=0.04)


def test_a_path_begins_with_the_velocity():
    phase = np.linspace(0.0, 1.0, 100)
    paths = [
        np.stack([100.0 * phase, bend * np.sin(np.pi * phase)], axis=1) for bend in (20, 25, 30)
    ]
    primitive = SMP.fit(paths, durations=[4.0, 5.0, 6.0])
    plan = primitive.adapt(
        [Circle((50.0, 25.0), 10.0)], start=(0.0, 0.0), start_velocity=(10.0, -8.0), particles=12
    )
    begins = np.diff(plan.trajectories[:, :3], axis=1) * 199.0 / 5.0
    # Of a parabola through the first three samples, the slope at the first.
    slope = 1.5 * begins[:, 0] - 0.5 * begins[:, 1]
    np.testing.assert_allclose(slope, np.tile([10.0, -8.0], (12, 1)), atol=0.3)
    assert plan.good.mean() > 0.8


def test_a_robot_goes_on_from_its_velocity(robot):
    arm = SMP.fit(swings(), robot=robot, durations=[4.0] * 5)
    velocity = np.array([0.3, -0.05, 0.02, 0.05, 0.0, 0.04, 0.0])
    start = arm.demonstrations[0][0]
    plan = arm.adapt(start=start, start_velocity=velocity, particles=6)
    assert plan.good.all()
    motion = robot.timed(plan.best, acceleration=4.0, start_velocity=np.linalg.norm(velocity))
    np.testing.assert_allclose(motion.positions[0], start, atol=1e-6)
    along = motion.velocities[0] / np.linalg.norm(motion.velocities[0])
    assert along @ velocity / np.linalg.norm(velocity) > 0.999
    assert np.linalg.norm(motion.velocities[0]) == pytest.approx(np.linalg.norm(velocity), rel=1e-3)


def test_a_velocity_that_means_nothing_is_refused(robot):
    paths = [np.stack([np.linspace(0, 1, 50), k * np.ones(50)], axis=1) for k in (0.0, 0.1, 0.2)]
    timed = SMP.fit(paths, durations=[1.0, 1.0, 1.0])
    with pytest.raises(ValueError, match=r"start_velocity needs the demonstrations' durations"):
        SMP.fit(paths).adapt(start_velocity=(1.0, 0.0))
    with pytest.raises(ValueError, match=r"start_velocity must have shape \(2,\)"):
        timed.adapt(start_velocity=(1.0, 0.0, 0.0))
    with pytest.raises(ValueError, match="start_velocity must be finite"):
        timed.adapt(start_velocity=(np.nan, 0.0))
    with pytest.raises(ValueError, match="modulation 'exact', got 'likelihood'"):
        timed.adapt(
            start_velocity=(1.0, 0.0), settings=AdaptSettings(modulation="likelihood", sigma=0.01)
        )


def test_what_a_robot_holds_stays_clear_as_physics_sees_it(robot):
    rod = Obstacle(
        shape="cylinder",
        position=(0.0, 0.0, 0.25),
        size=(0.02, 0.02, 0.15),
    )
    holding = robot.holding(rod)
    assert len(holding.model.link) > len(robot.model.link)
    assert set(holding.bodies) == {*robot.bodies, "what it holds"}
    arm = SMP.fit(swings(), robot=holding)
    middle = arm.demonstrations[0][40]
    end = robot.model.carried_points(middle, np.array([0.0, 0.0, 0.3]))[0]
    ball = Obstacle(shape="sphere", position=tuple(end.tolist()), size=(0.04, 0.04, 0.04))
    ends = {"start": arm.demonstrations[0][0], "goal": arm.demonstrations[0][-1]}
    plan = arm.adapt([ball], **ends, particles=12)
    assert plan.good.any()
    bare = SMP.fit(swings(), robot=robot).adapt([ball], **ends, method="promp", particles=12)
    held = arm.adapt([ball], **ends, method="promp", particles=12)
    assert held.collision_free.sum() < bare.collision_free.sum()
    client = BulletClient(pybullet.DIRECT)
    try:
        body = client.loadURDF(KUKA, useFixedBase=True)
        shape = client.createCollisionShape(client.GEOM_CYLINDER, radius=0.02, height=0.3)
        bar = client.createMultiBody(0.0, shape)
        shape = client.createCollisionShape(client.GEOM_SPHERE, radius=0.04)
        there = client.createMultiBody(0.0, shape, -1, ball.position)
        for configuration in plan.trajectories[plan.good][:, ::10].reshape(-1, 7):
            for joint, angle in enumerate(configuration):
                client.resetJointState(body, joint, angle)
            position, turn = client.getLinkState(body, 6, computeForwardKinematics=True)[4:6]
            at = client.multiplyTransforms(position, turn, rod.position, rod.quaternion)
            client.resetBasePositionAndOrientation(bar, *at)
            assert not client.getClosestPoints(bar, there, 0.0)
    finally:
        client.disconnect()


@pytest.mark.parametrize(
    ("bodies", "message"),
    [
        ([], "at least one Obstacle"),
        (None, "bodies must be Obstacles, got None"),
        (3, "bodies must be Obstacles, got 3"),
        (["rod"], r"bodies\[0\] must be an Obstacle that stands still"),
        (
            Obstacle(
                shape="box", position=(0, 0, 0), size=(0.1, 0.1, 0.1), velocity=(0.1, 0.0, 0.0)
            ),
            r"bodies\[0\] must be an Obstacle that stands still",
        ),
        (
            Obstacle(shape="box", position=(0, 0, 0), size=(3.0, 3.0, 3.0)),
            "too large to be covered|beyond the",
        ),
    ],
)
def test_what_cannot_be_held_is_refused(robot, bodies, message):
    with pytest.raises(ValueError, match=message):
        robot.holding(bodies)
