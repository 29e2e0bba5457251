"""Parses command lines; prints tables and progress."""
