"""The walker's programs compile for a GPU, also where none is."""

import importlib.util
import json
import os
import pathlib
import subprocess
import sys

import pytest

_SCRIPT = pathlib.Path(__file__).with_name("gpu_programs.py")


@pytest.mark.skipif(
    importlib.util.find_spec("jax_cuda12_plugin") is None,
    reason="needs the extra `gpu-compiler`",
)
def test_programs_for_a_gpu_never_wait_for_the_host():
    known = {"JAX_PLATFORMS": "cpu", "JAX_SKIP_CUDA_CONSTRAINTS_CHECK": "1"}
    done = subprocess.run(
        [sys.executable, _SCRIPT], env=os.environ | known, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    # Each kernel takes some 2 µs to start: they are few.
    for name, most in {"a tick": 80, "a tick on hardcore terrain": 110, "a chunk": 90}.items():
        assert told[name]["waits"] == 0
        assert told[name]["kernels"] <= most
