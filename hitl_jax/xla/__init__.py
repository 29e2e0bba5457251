"""Helps XLA compile our programs well: CPU products, fusion barriers, devices, a flag, keys."""
