"""PushLiftBox: push a box, grasp it on the way and lift it."""
