"""Occupancy maps of a scene: exact, learned, and baked into one grid of signed distance."""
