"""The commands of `hitl_jax`, to be started from a checkout."""
