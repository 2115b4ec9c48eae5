"""Movement primitives adapted to new scenes by Stein variational gradient descent."""
