"""Work that is killed at random moments and gone on with, compared with the same undisturbed."""

from smp_gym.optional_packages import require

require("dev", "smp_planner.experiments.kills")
