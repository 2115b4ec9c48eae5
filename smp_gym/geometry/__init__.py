"""Obstacle shapes: a module for each, their registry, and the distance to bodies made of them."""
