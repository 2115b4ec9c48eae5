"""DoubleSidedPlacement: set the object down on either of two pads."""
