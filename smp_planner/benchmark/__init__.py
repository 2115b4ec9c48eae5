"""Benchmark of methods on paired episodes; here alone the planner makes environments."""

from smp_gym.optional_packages import require

require("bench", "smp_planner.benchmark")
