"""The physics: PyBullet's world, the arm in it, and the workcell of a scene."""

from smp_gym.optional_packages import require_pybullet

require_pybullet()
