"""Data sets: demonstrations, frozen episodes, and scenes and data sets of others."""
