"""Randomised manipulation tasks of a Kinova JACO arm for Gymnasium.

Importing the package registers its environments, for example
``gymnasium.make("smp_gym/Placement-v0")``; `smp_gym.registration.ENVIRONMENTS` lists them all.
"""

from importlib.metadata import PackageNotFoundError, version

from smp_gym.registration import ENVIRONMENTS, register_envs, register_task

__all__ = ["ENVIRONMENTS", "__version__", "register_envs", "register_task"]

try:
    __version__ = version("smp-gym")
except PackageNotFoundError:  # A checkout on the path that is not installed.
    __version__ = "unknown"

register_envs()
