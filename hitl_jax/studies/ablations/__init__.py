"""The parts of `hitl-jax ablation`."""
