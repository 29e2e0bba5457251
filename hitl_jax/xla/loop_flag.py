"""Sets the XLA flag that compiles each loop into one CPU kernel, which the JAX walkers need.

A step of a walker is loops of 180 and 60 iterations. By default XLA starts a kernel for each
operation in each iteration of a loop over more than a kilobyte: that takes a quarter of the time
with 512 walkers, and half with 256.
"""

import os

_ANY_SIZE = "xla_cpu_small_while_loop_byte_threshold=1000000000"


def have_loops_in_one_kernel() -> None:
    """Makes XLA compile a loop of any size into one kernel; sets XLA_FLAGS.

    Call it before JAX makes its first array, since XLA reads its flags once. It changes nothing if
    XLA_FLAGS has `--xla_backend_extra_options` already. The learner's programs stay as they are. So
    does a loop with a scatter, such as the loop over a chunk's ticks (`device_stage`): acting there
    rounds as in the host's loop.
    """
    flags = os.environ.get("XLA_FLAGS", "")
    if "xla_backend_extra_options" not in flags:
        os.environ["XLA_FLAGS"] = f"{flags} --xla_backend_extra_options={_ANY_SIZE}".strip()
