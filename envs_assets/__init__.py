"""Data files of the tasks: the arm, the demonstrations and the trained maps."""
