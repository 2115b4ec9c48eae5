"""Inspection of environments: checks at length, feasible references, speed, sheets of scenes."""
