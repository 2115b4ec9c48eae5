"""Reinforcement-learning agents on the tasks, trained with stable-baselines3."""
