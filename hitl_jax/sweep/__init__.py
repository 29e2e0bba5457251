"""Runs trained, tested, saved and gone on with: what all commands that train have in common."""
