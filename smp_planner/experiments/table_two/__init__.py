"""Table II of the paper: one scene of each task, many repetitions, every particle executed."""
