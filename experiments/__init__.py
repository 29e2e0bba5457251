"""Entry points: the sweep, its figures and the benchmark."""
