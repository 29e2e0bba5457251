"""Sets the XLA flags that make fewer kernels of loops, which the JAX walkers and the learner need.

A step of a walker is loops of 180 and 60 iterations. By default XLA starts a kernel on a CPU for
each operation in each iteration of a loop over more than a kilobyte: that takes a quarter of the
time with 512 walkers, and half with 256. On a GPU the host starts each kernel, unless XLA makes
graphs of them; by default none of loops and conditions, and with a thousand runs the GPU waits for
the host a third of the time. What does not depend on each other in a graph can run at once.
"""

import os

_FLAGS = {
    "xla_backend_extra_options": "xla_cpu_small_while_loop_byte_threshold=1000000000",
    "xla_gpu_enable_command_buffer": "+WHILE,+CONDITIONAL",
    "xla_gpu_command_buffer_scheduling_mode": "CONCURRENT",
}


def have_loops_in_one_kernel() -> None:
    """Makes XLA compile a loop of any size into one kernel, or on a GPU graph; sets XLA_FLAGS.

    Call it before JAX makes its first array, since XLA reads its flags once. Flags that XLA_FLAGS
    has already stay as they are. On CPUs the learner's programs stay as they are. So does a loop
    with a scatter, such as the loop over a chunk's ticks (`device_stage`): acting there rounds as
    in the host's loop.
    """
    flags = os.environ.get("XLA_FLAGS", "")
    for name, value in _FLAGS.items():
        if name not in flags:
            flags = f"{flags} --{name}={value}"
    os.environ["XLA_FLAGS"] = flags.strip()
