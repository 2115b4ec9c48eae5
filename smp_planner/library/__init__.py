"""What `smp_planner.library.smp` is made of: primitives adapted to scenes of the user's own."""
