"""The arm as numbers: chain, limits, link spheres, forward and inverse kinematics; no physics."""

from smp_gym.robot import chain, inverse, spheres
from smp_gym.robot.chain import *  # noqa: F403
from smp_gym.robot.inverse import *  # noqa: F403
from smp_gym.robot.spheres import *  # noqa: F403

__all__ = [*chain.__all__, *inverse.__all__, *spheres.__all__]
