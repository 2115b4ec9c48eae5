"""The KUKA arm of PyBullet's data, and demonstrations of it."""

import numpy as np
import pybullet_data

KUKA = f"{pybullet_data.getDataPath()}/kuka_iiwa/model.urdf"
LINKS = [f"lbr_iiwa_link_{number}" for number in range(8)]


def swings(count=5):
    """Return demonstrations (80, 7) rad that swing the arm about its base."""
    rng = np.random.default_rng(0)
    start = np.array([-0.8, 0.5, 0.0, -1.4, 0.0, 1.2, 0.0])
    share = np.linspace(0.0, 1.0, 80)[:, None]
    rise = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
    turn = np.array([1.6, 0.1, 0.0, 0.1, 0.0, 0.0, 0.0])
    return [start + rise * turn + rng.normal(0.0, 0.03, 7) for _ in range(count)]
