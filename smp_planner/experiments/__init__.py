"""Experiments of the paper that need no environment, each as data, rows and tables."""

from smp_gym.optional_packages import require

require("bench", "smp_planner.experiments")
