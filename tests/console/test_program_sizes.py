"""No program of ours is large: how long XLA compiles goes by the instructions in its kernels.

They are counted, not timed, so that the speed of a machine does not matter. XLA computes a value
again in each kernel that uses it: a careless line can double a program (docs/walker.md). What takes
long for another reason is not seen here.
"""

import collections
import os
import re
import subprocess
import sys
import time

import pytest

pytestmark = pytest.mark.slow

_MOST_INSTRUCTIONS = 50_000
"""Of a program; the largest, of about 39,000, takes 20 to 50 seconds to compile on two cores."""

_SWEEP = """
import sys
from hitl_jax.__main__ import main
few = "--methods srl --seeds 1 --episodes 1 --test-episodes 1 --warmup-steps 64 --capacity 256"
main(["sweep", *few.split(), "--backend", "{}", "--out", sys.argv[1]])
"""

_HARDCORE = """
import numpy as np
from hitl_jax.envs import HARDCORE_WALKER, Command, make_pool
with make_pool("jax", 1, env_id=HARDCORE_WALKER) as pool:
    pool.step(np.array([Command.RESET]), np.zeros((1, 4)), np.zeros(1))
"""

_WORK = {
    "host": (_SWEEP.format("lean"), {"act_packed", "_begin"}),
    "device": (_SWEEP.format("jax"), {"_play", "learn_all", "play_groups"}),
    "hardcore": (_HARDCORE, {"tick", "new_walkers"}),
}


@pytest.mark.parametrize("kind", _WORK)
def test_no_program_is_large(kind, tmp_path):
    work, expected = _WORK[kind]
    sizes = _sizes(work, expected, tmp_path)
    assert expected <= set(sizes), sorted(sizes)
    assert {name: size for name, size in sizes.items() if size > _MOST_INSTRUCTIONS} == {}


def _sizes(work, expected, folder):
    """Instructions of each program that some work compiles, within kernels and between them.

    The work is stopped as soon as all are there that are expected: it is not what is looked at.
    """
    dump, out = folder / "dump", folder / "out"
    flags = f"--xla_dump_to={dump} --xla_dump_hlo_as_text --xla_dump_hlo_pass_re="
    environment = {
        **os.environ,
        "JAX_ENABLE_COMPILATION_CACHE": "false",
        "JAX_NUM_CPU_DEVICES": "1",  # Each device would compile the same again.
        "XLA_FLAGS": f"{os.environ.get('XLA_FLAGS', '')} {flags}",
    }
    with subprocess.Popen([sys.executable, "-c", work, str(out)], env=environment) as process:
        while process.poll() is None and not expected <= set(_programs(dump)):
            time.sleep(0.2)
        time.sleep(1.0)  # The last file may be half written.
        process.kill()
    sizes = {}
    for name, paths in _programs(dump).items():
        sizes[name] = max(path.read_text().count(" = ") for path in paths)
    return sizes


def _programs(dump):
    """Files of the programs that XLA has optimised, by name."""
    paths = collections.defaultdict(list)
    for path in dump.glob("*.cpu_after_optimizations.txt"):
        name = re.fullmatch(r"module_\d+\.jit_(.*)\.cpu_after_optimizations\.txt", path.name)
        if name:
            paths[name[1]].append(path)
    return paths
