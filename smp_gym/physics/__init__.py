"""The physics: PyBullet's world, the arm in it, and the workcell of a scene."""
