"""What is perceived of the obstacles: their exact poses, noisy ones, or a depth camera's points."""
