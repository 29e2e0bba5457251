"""The parts of `experiments.benchmark`; each gives the rows of a table."""
