"""The planning pipeline: from a problem to a plan."""
