"""Planners as policies: observations to problems, plans to actions."""
