"""The walker's programs compile for a GPU, also on a machine without one."""

import importlib.util
import json
import os
import pathlib
import subprocess
import sys

import pytest

_SCRIPT = pathlib.Path(__file__).parents[1] / "gpu_programs.py"


@pytest.mark.skipif(
    importlib.util.find_spec("jax_cuda12_plugin") is None,
    reason="needs the extra `gpu-compiler`",
)
def test_programs_compile_for_a_gpu():
    known = {"JAX_PLATFORMS": "cpu", "JAX_SKIP_CUDA_CONSTRAINTS_CHECK": "1"}
    done = subprocess.run(
        [sys.executable, _SCRIPT], env=os.environ | known, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert list(told) == ["a tick", "a tick on hardcore terrain", "a chunk"]
    # Each kernel takes some 2 µs to start: they are few.
    for counts, limit in zip(told.values(), (80, 110, 90), strict=True):
        assert counts["waits"] == 0
        assert counts["kernels"] <= limit
