"""The commands that `hitl_jax.__main__` lists: options in, a call, words out."""
