"""The scripted demonstrator of Placement."""

from smp_gym.scene import Goal
from smp_gym.tasks.placement.rules import (
    NOMINAL_BIN,
    RELEASE_HEIGHT,
    RELEASE_TILT,
    START_CONFIGURATION,
)
from smp_gym.tasks.placing_demonstrator import Script

__all__ = ["SCRIPT", "demonstrate"]

SCRIPT = Script(
    task="Placement",
    start=START_CONFIGURATION,
    goals=(Goal(position=NOMINAL_BIN),),
    targets=(0,) * 7,
    release_height=RELEASE_HEIGHT,
    tilt=RELEASE_TILT,
    duration=(10.5, 13.0),
    lift=(0.04, 0.14),
)

demonstrate = SCRIPT.record
