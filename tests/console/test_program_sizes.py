"""No program of ours is large: how long XLA compiles goes by the instructions in its kernels.

They are counted, not timed, so that the speed of a machine does not matter. XLA computes a value
again in each kernel that uses it: a careless line can double a program (docs/walker.md). What takes
long for another reason is not seen here.
"""

import os
import re
import subprocess
import sys

import pytest

_MOST_INSTRUCTIONS = 50_000
"""Of a program; the largest, of about 39,000, takes 20 to 50 seconds to compile on two cores."""

_SWEEP = """
import sys
from hitl_jax.__main__ import main
few = "--seeds 1 --episodes 1 --test-episodes 1 --warmup-steps 64 --capacity 256 --backend {}"
assert main(["sweep", *few.split(), "--out", sys.argv[1]]) == 0
"""

_HARDCORE = """
import numpy as np
from hitl_jax.envs import HARDCORE_WALKER, Command, make_pool
with make_pool("jax", 1, env_id=HARDCORE_WALKER) as pool:
    pool.step(np.array([Command.RESET]), np.zeros((1, 4)), np.zeros(1))
"""

_WORK = {
    "host": (_SWEEP.format("lean"), {"act_packed", "learn_all", "_begin"}),
    "device": (_SWEEP.format("jax"), {"_play", "learn_all", "_begin"}),
    "hardcore": (_HARDCORE, {"tick", "new_walkers"}),
}


@pytest.mark.parametrize("kind", _WORK)
def test_no_program_is_large(kind, tmp_path):
    work, expected = _WORK[kind]
    sizes = _sizes(work, tmp_path)
    assert expected <= set(sizes), sorted(sizes)
    assert {name: size for name, size in sizes.items() if size > _MOST_INSTRUCTIONS} == {}


def _sizes(work, folder):
    """Instructions of each program that some work compiles, within kernels and between them."""
    dump = folder / "dump"
    flags = f"--xla_dump_to={dump} --xla_dump_hlo_as_text --xla_dump_hlo_pass_re="
    environment = {
        **os.environ,
        "JAX_ENABLE_COMPILATION_CACHE": "false",
        "JAX_NUM_CPU_DEVICES": "1",  # Each device would compile the same again.
        "XLA_FLAGS": f"{os.environ.get('XLA_FLAGS', '')} {flags}",
    }
    subprocess.run([sys.executable, "-c", work, str(folder / "out")], env=environment, check=True)
    sizes = {}
    for path in dump.glob("*.cpu_after_optimizations.txt"):
        name = re.fullmatch(r"module_\d+\.jit_(.*)\.cpu_after_optimizations\.txt", path.name)
        if name:
            size = path.read_text().count(" = ")
            sizes[name[1]] = max(size, sizes.get(name[1], 0))
    return sizes
