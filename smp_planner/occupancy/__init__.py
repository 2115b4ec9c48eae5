"""Where a scene is occupied: exact, learned, and baked into one grid of signed distance."""
