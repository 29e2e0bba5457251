"""Walkers and a small sweep on a GPU, where JAX sees one."""

import functools
import importlib.util
import json
import os
import subprocess
import sys

import numpy as np
import pytest

from hitl_jax.agreement.accelerator import CLOSE_BAR, STEPS
from hitl_jax.results.folder import ResultsFolder

_OF_TESTS = ("JAX_PLATFORMS", "JAX_DISABLE_MOST_OPTIMIZATIONS", "JAX_NUM_CPU_DEVICES")
_MEASURE = "; ".join(
    (
        "import json, sys",
        "from hitl_jax.agreement.accelerator import measure_accelerator",
        "print(json.dumps(measure_accelerator(0, sys.argv[1] == 'True')))",
    )
)


def _python(*arguments):
    """What a Python says that is not kept to the CPU, as these tests are."""
    environment = {name: value for name, value in os.environ.items() if name not in _OF_TESTS}
    environment["XLA_PYTHON_CLIENT_PREALLOCATE"] = "false"
    done = subprocess.run(
        [sys.executable, *arguments], env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@functools.cache
def _sees_gpu():
    plugins = "jax_cuda12_plugin", "jax_cuda13_plugin"
    if not any(map(importlib.util.find_spec, plugins)):
        return False
    return _python("-c", "import jax; print(jax.default_backend())").split()[-1] == "gpu"


@pytest.fixture(autouse=True)
def _needs_gpu():
    if not _sees_gpu():
        pytest.skip("JAX sees no GPU")


@pytest.mark.parametrize("hardcore", [False, True])
def test_walkers_move_as_on_the_cpu(hardcore):
    one, *several = json.loads(_python("-c", _MEASURE, str(hardcore)))
    assert one["walkers"] > 10_000
    assert one["share within 1e-06"] >= CLOSE_BAR
    assert len(several) == len(STEPS)
    # Walks are chaotic: a hull that is moved by 1e-6 m does no better, see `hitl-jax agreement`.
    assert several[0]["median error"] < 1e-5
    assert several[1]["median error"] < 1e-2


def test_a_small_sweep_plays_learns_and_tests(tmp_path):
    scale = "--seeds", "2", "--episodes", "6", "--test-episodes", "2"
    learns = "--warmup-steps", "200"
    out = tmp_path / "sweep"
    _python("-m", "hitl_jax", "sweep", "--backend", "jax", "--out", str(out), *scale, *learns)
    runs = ResultsFolder(out).load_all()
    assert len(runs) == 6
    for run in runs:
        assert run.info["updates"] > 0 and run.info["diverged"] is None
        assert len(run.episodes["return"]) == 6
        assert np.isfinite(run.tests["return"]).all()
