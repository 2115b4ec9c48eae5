"""DrawS: draw an S in the air with a pen."""
