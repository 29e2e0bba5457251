"""Parts of `hitl-jax agreement`."""
