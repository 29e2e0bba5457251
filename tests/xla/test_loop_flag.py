"""Every command compiles a loop into one kernel, unless XLA_FLAGS says otherwise."""

import os
import subprocess
import sys

import pytest

_SCRIPT = """
from hitl_jax.__main__ import main
main(["verify", "nowhere"])
import jax
import jax.numpy as jnp
def rounds(x):
    return jax.lax.fori_loop(0, 9, lambda _, x: jnp.sin(x) + x[::-1], x)
print("small_call" in jax.jit(rounds).lower(jnp.ones(1000)).compile().as_text())
"""


@pytest.mark.parametrize(
    ("options", "whole"),
    [
        ("", "True"),
        ("--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=0", "False"),
    ],
)
def test_loops_are_one_kernel(options, whole):
    done = subprocess.run(
        [sys.executable, "-c", _SCRIPT],
        env={**os.environ, "XLA_FLAGS": options},
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    assert done.stdout.strip() == whole
