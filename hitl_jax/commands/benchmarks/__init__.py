"""The parts of `hitl-jax benchmark`; each gives the rows of a table."""
