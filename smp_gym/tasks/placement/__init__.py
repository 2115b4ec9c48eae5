"""Placement: carry an object into a bin."""
