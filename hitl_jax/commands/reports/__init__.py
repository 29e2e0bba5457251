"""The parts of `hitl-jax report`."""
