"""Playing a joint trajectory in the environment: what tests of data and of scenes judge by."""

import numpy as np

from smp_gym.kinematics import JOINT_VELOCITY
from smp_gym.observation import CONTROL_PERIOD

SPEED = 0.95
WAITING_STEPS = 60


def play(env, scene, trajectory, duration=None):
    """Execute a (T, 6) trajectory at constant speed of phase, let go at its end; return info.

    Without a duration it is executed as fast as `SPEED` times the velocity limits allow.
    """
    phase = np.linspace(0.0, 1.0, len(trajectory))
    if duration is None:
        rate = np.abs(np.gradient(trajectory, phase, axis=0)) / JOINT_VELOCITY
        duration = rate.max() / SPEED
    steps = int(np.ceil(duration / CONTROL_PERIOD))
    at = np.linspace(0.0, 1.0, steps + 1)
    targets = np.stack([np.interp(at, phase, column) for column in trajectory.T], axis=1)
    observation, info = env.reset(options={"scene": scene})
    for step in range(1, steps + WAITING_STEPS):
        reference = observation["observation"][6:12]
        action = np.zeros(7, np.float32)
        wanted = targets[min(step, steps)]
        action[:6] = np.clip((wanted - reference) / (JOINT_VELOCITY * CONTROL_PERIOD), -1.0, 1.0)
        action[6] = -1.0 if step > steps else 0.0
        observation, _, terminated, truncated, info = env.step(action)
        if terminated or truncated:
            break
    return info
