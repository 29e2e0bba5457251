"""Entry points: the sweep, its figures and the benchmark."""

from hitl_jax.flags import have_loops_in_one_kernel

# Here, so that all commands round alike: what one has played another plays again.
have_loops_in_one_kernel()
