"""The arm as numbers: chain, limits, spheres, forward and inverse kinematics."""
