"""Arms whose URDFs come with public packages, and demonstrations that heed no obstacle."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from smp_gym.arrays import FloatArray
from smp_gym.assets import asset_path
from smp_planner.library.urdf import Robot

__all__ = ["PUBLIC_ARMS", "PublicArm", "swings"]

_ROBOTS = "cmeel.prefix/share/example-robot-data/robots"


@dataclass(frozen=True)
class PublicArm:
    """An arm and where its URDF is.

    Attributes:
        package: distribution that brings the file; None for that of this project.
        file: in the folder into which packages are installed, or among the assets.
        tip: link that is the tool.
        ready: (n) rad, a posture with the tool in front, above where things stand.
    """

    package: str | None
    file: str
    tip: str
    ready: tuple[float, ...]

    def path(self) -> Path:
        """Return where the URDF is.

        Raises:
            FileNotFoundError: the package is not installed.
        """
        if self.package is None:
            return Path(asset_path(*self.file.split("/")))
        try:
            return Path(str(distribution(self.package).locate_file(self.file)))
        except PackageNotFoundError:
            raise FileNotFoundError(f"{self.file} is part of {self.package}: install it") from None

    def robot(self, overshoot: float) -> Robot:
        """Return the arm with spheres that stand out by at most `overshoot`, m."""
        return Robot.from_urdf(self.path(), self.tip, overshoot=overshoot)


PUBLIC_ARMS = {
    "jaco": PublicArm(
        None, "jaco/jaco.urdf", "j2s6s200_end_effector", (0.0, 2.9, 1.3, -2.1, 1.4, 0.0)
    ),
    "ur5": PublicArm(
        "example-robot-data",
        f"{_ROBOTS}/ur_description/urdf/ur5_robot.urdf",
        "tool0",
        (0.0, -1.2, 1.6, -1.9, -1.57, 0.0),
    ),
    "kuka_iiwa": PublicArm(
        "pybullet",
        "pybullet_data/kuka_iiwa/model.urdf",
        "lbr_iiwa_link_7",
        (0.0, 0.55, 0.0, -1.35, 0.0, 1.2, 0.0),
    ),
    "panda": PublicArm(
        "example-robot-data",
        f"{_ROBOTS}/panda_description/urdf/panda.urdf",
        "panda_hand",
        (0.0, 0.1, 0.0, -2.0, 0.0, 2.1, 0.8),
    ),
}
"""Arms by name."""


def swings(
    start: ArrayLike, goal: ArrayLike, rng: np.random.Generator, count: int = 7, samples: int = 100
) -> FloatArray:
    """Return demonstrations (count, samples, n) rad from one posture to another, each bent anew.

    Args:
        start: (n,) rad, where they begin, up to 0.05 rad.
        goal: (n,) rad, where they end, likewise.
        rng: of ends and bends.
        count: of demonstrations.
        samples: of each.
    """
    ends = np.stack([np.asarray(start, np.float64), np.asarray(goal, np.float64)])
    share = np.linspace(0.0, 1.0, samples)
    rise = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
    varied = ends + rng.normal(0.0, 0.05, (count, *ends.shape))
    bends = rng.normal(0.0, 0.12, (count, 1, ends.shape[1]))
    return np.asarray(
        varied[:, :1]
        + rise[:, None] * (varied[:, 1:] - varied[:, :1])
        + np.sin(np.pi * rise)[:, None] * bends
    )
