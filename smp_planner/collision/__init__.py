"""Collisions: the robot model, compiled kernels, costs, and exact checks."""
