"""Trains many runs side by side: compiled batch, host loop, saved runs."""
