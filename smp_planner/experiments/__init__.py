"""Experiments of the paper that need no environment, each as data, rows and tables."""
