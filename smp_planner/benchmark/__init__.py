"""Measuring methods on paired episodes. The only room of the planner that makes environments."""
