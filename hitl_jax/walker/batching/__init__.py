"""Turns functions of one walker into fast functions of many walkers."""
