"""Stein Movement Primitives for demonstrations and scenes of the user's own; see `library.smp`."""
