"""Benchmark of methods on paired episodes; here alone the planner makes environments."""
