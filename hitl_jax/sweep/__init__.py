"""Trains, tests, saves and resumes runs: shared by all commands that train."""
