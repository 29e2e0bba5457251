"""Comparisons of settings: ablations of the team, and tuning of the learner."""
