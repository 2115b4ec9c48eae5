import numpy as np
import pytest

from smp_gym.observation import CONTROL_PERIOD
from smp_gym.robot.kinematics import JOINT_VELOCITY
from smp_planner.collision.costs import VELOCITY_FRACTION
from smp_planner.collision.verification import minimum_duration
from smp_planner.policy.tracking import SETTLING_STEPS, GripperEvent, Track, gripper_event


def minimum_jerk(start, end, samples=200):
    z = np.linspace(0, 1, samples)[:, None]
    return start + (end - start) * (10 * z**3 - 15 * z**4 + 6 * z**5)


START, END = np.array([-0.8, 3.5, 1.0, 0.0, 2.7, 0.0]), np.array([-2.1, 3.8, 0.8, 0.3, 2.4, 0.1])


def integrate(track, steps, reference=START, disturb=None):
    """Play the environment: a reference that moves by the action's share of the limits."""
    references, actions = [reference.copy()], []
    for step in range(steps):
        if disturb is not None and step == disturb[0]:
            references[-1] = references[-1] + disturb[1]
        action = track.action(track.first_step + step, references[-1])
        assert action.shape == (7,)
        assert action.dtype == np.float32
        assert (np.abs(action) <= 1).all()
        move = action[:6].astype(float) * JOINT_VELOCITY * CONTROL_PERIOD
        references.append(references[-1] + move)
        actions.append(action)
    return np.array(references), np.array(actions)


@pytest.mark.parametrize("first_step", [0, 35])
def test_the_reference_follows_the_trajectory_within_the_limits(first_step):
    trajectory = minimum_jerk(START, END)
    duration = float(minimum_duration(trajectory[None], JOINT_VELOCITY)[0])
    track = Track(trajectory, duration, None, first_step)
    steps = int(np.ceil(duration / CONTROL_PERIOD)) + 3
    references, actions = integrate(track, steps)
    np.testing.assert_allclose(references[-1], END, atol=1e-6)
    assert np.abs(actions[:, :6]).max() <= VELOCITY_FRACTION + 1e-5
    assert np.abs(actions[:, :6]).max() >= 0.95 * VELOCITY_FRACTION
    times = np.arange(len(references)) * CONTROL_PERIOD / duration
    for j in range(6):
        expected = np.interp(times, np.linspace(0, 1, 200), trajectory[:, j])
        np.testing.assert_allclose(references[:, j], expected, atol=1e-6)
    assert (actions[:, 6] == 0).all()


def test_a_disturbed_reference_is_brought_back():
    track = Track(minimum_jerk(START, END), 6.0, None)
    references, _ = integrate(track, 140, disturb=(40, np.full(6, 0.05)))
    np.testing.assert_allclose(references[-1], END, atol=1e-6)


def test_the_hand_opens_once_the_arm_has_arrived():
    track = Track(minimum_jerk(START, END), 6.0, GripperEvent(phase=1.0, command=-1.0))
    _, actions = integrate(track, 150)
    opening = np.flatnonzero(actions[:, 6] < 0)
    assert opening[0] == 120 + SETTLING_STEPS
    assert (actions[: opening[0], 6] == 1.0).all()
    assert (actions[opening[0] :, 6] == -1.0).all()
    assert np.abs(actions[opening[0] :, :6]).max() < 1e-6


def test_an_event_within_the_trajectory_happens_there():
    track = Track(minimum_jerk(START, END), 6.0, GripperEvent(phase=0.25, command=1.0))
    _, actions = integrate(track, 60)
    assert (actions[:30, 6] == -1.0).all()
    assert (actions[30:, 6] == 1.0).all()


@pytest.mark.parametrize("command", [-1.0, 1.0])
def test_the_phase_is_where_the_reference_is_led(command):
    """Also while the arm stands still because the hand closes."""
    line = np.linspace(0.0, 0.01, 11)[:, None] * np.ones(6)
    track = Track(line, 4.9 * CONTROL_PERIOD, GripperEvent(0.5, command), first_step=3)
    phases = [track.phase(step) for step in range(3, 40)]
    for step, phase in zip(range(2, 39), phases, strict=True):
        led_to = track.action(step, np.zeros(6))[:6] * CONTROL_PERIOD * JOINT_VELOCITY
        np.testing.assert_allclose(led_to, 0.01 * phase, atol=1e-7)
    assert phases[0] == 0.0
    assert phases[-1] == 1.0


def test_the_event_is_learned_from_demonstrations():
    gripper = np.ones((3, 101))
    for row, first in zip(gripper, (40, 50, 60), strict=True):
        row[first:] = 0.1
    event = gripper_event(gripper)
    assert event == GripperEvent(phase=pytest.approx(0.5), command=-1.0)
    assert gripper_event(1 - gripper).command == 1.0
    assert gripper_event(np.ones((3, 101))) is None
