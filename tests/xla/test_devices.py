"""Priorities of the learner's threads, and how many runs a device learns at once."""

import os
import subprocess
import sys

import jax
import pytest
from jaxlib import xla_client

from hitl_jax.xla import devices

_SCRIPT = """
import contextlib, os
os.nice(3)
from hitl_jax.xla.devices import acting_device, learning_devices
acting_device(), learning_devices()
nice = set()
for thread in os.listdir("/proc/self/task"):
    with contextlib.suppress(ProcessLookupError):  # It has ended.
        nice.add(os.getpriority(os.PRIO_PROCESS, int(thread)))
print(os.getpriority(os.PRIO_PROCESS, 0), *sorted(nice))
"""


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere threads have no priorities")
def test_learning_threads_have_lower_priority():
    answer = subprocess.run(
        [sys.executable, "-c", _SCRIPT], stdout=subprocess.PIPE, text=True, check=True
    )
    usual = min(os.nice(0) + 3, 19)  # These tests may run under `nice` themselves.
    told = [int(nice) for nice in answer.stdout.split()]
    assert told == [usual, *sorted({usual, min(usual + 10, 19)})]


def test_an_accelerator_learns_all_its_runs_at_once_and_a_cpu_one(monkeypatch):
    monkeypatch.setattr(devices, "learning_devices", lambda: ("one", "another"))
    assert devices.default_tile(32) == devices.default_tile(64) == 1
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    assert devices.default_tile(32) == 16


@pytest.mark.parametrize("change", ["gone", "other arguments"])
def test_without_make_cpu_client_jaxs_own_cpu_is_used(monkeypatch, change):
    if change == "gone":
        monkeypatch.delattr(xla_client, "make_cpu_client")
    else:
        monkeypatch.setattr(xla_client, "make_cpu_client", lambda: None)
    with pytest.warns(UserWarning, match="gives no device threads of its own"):
        device = devices.cpu_device(f"test of {change}")
    assert device == jax.local_devices(backend="cpu")[0]
