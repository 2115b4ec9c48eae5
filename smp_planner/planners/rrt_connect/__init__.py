"""RRT-Connect in joint space, with shortcuts."""
