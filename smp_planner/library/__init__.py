"""What `smp_planner.adapt` is made of: primitives adapted to scenes of the user's own."""
