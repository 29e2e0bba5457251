"""Stands in Box2D's way where this folder is in PYTHONPATH, as if it were not installed."""

raise ImportError("No module named 'Box2D': tests/without_box2d is in PYTHONPATH")
