"""The commands that `hitl_jax.__main__` lists, and what only they use."""

from hitl_jax.xla.loop_flag import have_loops_in_one_kernel

# Here, so that all commands round alike: what one has played another plays again.
have_loops_in_one_kernel()
