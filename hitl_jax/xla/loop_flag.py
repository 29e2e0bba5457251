"""A flag of XLA's that makes walkers of `hitl_jax.walker` faster on a CPU."""

import os

_ANY_SIZE = "xla_cpu_small_while_loop_byte_threshold=1000000000"


def have_loops_in_one_kernel() -> None:
    """Has XLA make one kernel of a loop, of any size, instead of one of each operation in it.

    To be called before JAX makes its first array, since XLA reads its flags once. A step of a
    walker is loops, of 180 rounds and of 60, whose kernels are otherwise started anew in each
    round: that takes a quarter of the time with 512 walkers, and half with 256. XLA does it by
    itself where a loop is over a kilobyte at most. The learner's programs stay as they are, and so
    does a loop with a scatter, as that over a chunk's ticks has (`device_stage`), so that acting
    rounds there as in the host's loop. Where XLA_FLAGS has options of this kind already, nothing is
    done.
    """
    flags = os.environ.get("XLA_FLAGS", "")
    if "xla_backend_extra_options" not in flags:
        os.environ["XLA_FLAGS"] = f"{flags} --xla_backend_extra_options={_ANY_SIZE}".strip()
