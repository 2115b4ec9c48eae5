"""Randomised manipulation tasks of a Kinova JACO arm for Gymnasium.

Importing the package registers its environments, for example
``gymnasium.make("smp_gym/Placement-v0")``; `smp_gym.registration.ENVIRONMENTS` lists them all.
"""

from smp_gym.registration import ENVIRONMENTS, register_envs, register_task

__all__ = ["ENVIRONMENTS", "register_envs", "register_task"]

register_envs()
