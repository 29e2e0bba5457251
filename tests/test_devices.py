"""The threads of the learner give way, whatever the priority that the process was given."""

import subprocess
import sys

import pytest

_SCRIPT = """
import os, pathlib
os.nice(3)
from hitl_jax.devices import acting_device, cpu_device
acting_device(), cpu_device(0)
tasks = pathlib.Path("/proc/self/task").iterdir()
nice = {os.getpriority(os.PRIO_PROCESS, int(task.name)) for task in tasks}
print(os.getpriority(os.PRIO_PROCESS, 0), *sorted(nice))
"""


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere threads have no priorities")
def test_learning_threads_let_others_go_first():
    answer = subprocess.run(
        [sys.executable, "-c", _SCRIPT], stdout=subprocess.PIPE, text=True, check=True
    )
    assert answer.stdout.split() == ["3", "3", "13"]
