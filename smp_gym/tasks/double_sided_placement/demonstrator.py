"""The scripted demonstrator of DoubleSidedPlacement."""

from smp_gym.scene import Goal, ManipulatedObject
from smp_gym.tasks.double_sided_placement.rules import (
    NOMINAL_PADS,
    RELEASE_GAP,
    START_CONFIGURATION,
    TILT,
)
from smp_gym.tasks.placing_demonstrator import Script

__all__ = ["SCRIPT", "demonstrate"]

SCRIPT = Script(
    task="DoubleSidedPlacement",
    start=START_CONFIGURATION,
    goals=tuple(Goal(kind="pad", position=position) for position in NOMINAL_PADS),
    targets=(0,) * 7 + (1,) * 7,
    release_height=ManipulatedObject().size[2] + RELEASE_GAP,
    tilt=TILT,
    duration=(8.0, 10.0),
    lift=(0.03, 0.11),
)

demonstrate = SCRIPT.record
