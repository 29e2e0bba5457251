"""Compiled programs are kept from one start to the next, and change no number."""

import os
import subprocess
import sys

import pytest

_SCRIPT = """
import sys
from hitl_jax.sweep.compile_cache import keep_programs
keep_programs()
from toy import ToyPool
from hitl_jax.benchmarks.loop import specs_of
from hitl_jax.team.agent import make_agent
from hitl_jax.config import AgentConfig, Method
from hitl_jax.training.rollout import Rollout
from hitl_jax.training.run_spec import LoopConfig
import jax
missed = []
jax.monitoring.register_event_listener(
    lambda event, **_: missed.append(event) if event.endswith("cache_misses") else None
)
agent = make_agent(AgentConfig(learner="td3", hidden_sizes=(16,), batch_size=16))
rollout = Rollout(agent, specs_of(list(Method), 4), ToyPool(4), LoopConfig(capacity=1024))
chunks = iter(rollout)
for _ in range(50):
    next(chunks)
train = rollout.collect(rollout.runs()[0]).train
print(len(missed) == 0, [leaf.tobytes().hex() for leaf in jax.tree.leaves(train.learner.actor)])
"""


@pytest.mark.slow
def test_a_second_start_loads_its_programs_and_gives_the_same_numbers(tmp_path):
    environment = {
        **os.environ,
        "JAX_ENABLE_COMPILATION_CACHE": "true",
        "JAX_COMPILATION_CACHE_DIR": str(tmp_path / "cache"),
        # Every program: one near the threshold may pass it in one start and not in the other.
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
        "PYTHONPATH": os.pathsep.join(sys.path),
    }
    command = [sys.executable, "-c", _SCRIPT]
    first, second = (
        subprocess.run(command, env=environment, stdout=subprocess.PIPE, text=True, check=True)
        for _ in range(2)
    )
    assert first.stdout.startswith("False")
    assert second.stdout.startswith("True")
    assert first.stdout.split(" ", 1)[1] == second.stdout.split(" ", 1)[1]
