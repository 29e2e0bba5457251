"""Sweeps that are killed and disturbed on purpose."""
