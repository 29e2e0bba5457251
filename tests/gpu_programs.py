"""Compiles the walker's programs for an NVIDIA H100 that need not be there, and counts kernels.

Run as a program, since JAX must be told before it is imported:

    JAX_PLATFORMS=cpu JAX_SKIP_CUDA_CONSTRAINTS_CHECK=1 python tests/gpu_programs.py

It prints, for each program, kernels a tick, and how often a tick waits for the host to look at a
condition. Kernels are counted in XLA's optimised program: what fuses, copies or is called.
"""

import functools
import json
import re

import jax
import jax.numpy as jnp
from jax.experimental import topologies

from hitl_jax.config import AgentConfig
from hitl_jax.envs import jax_pool
from hitl_jax.team.agent import make_agent
from hitl_jax.training import batch_arrays, compiled_batch, device_stage
from hitl_jax.training.device_ticks import ChunkStart
from hitl_jax.xla import gpu

_RUNS, _LANES, _TICKS = 1002, 1008, 16
_H100 = """
platform_name: "CUDA"
device_description_str: "NVIDIA H100"
dnn_version_info { major: 9 }
gpu_device_info {
  name: "NVIDIA H100" device_vendor: "NVIDIA Corporation" platform_version: "9.0"
  cuda_compute_capability { major: 9 }
  core_count: 132 fpus_per_core: 128 clock_rate_ghz: 1.98
  threads_per_warp: 32 threads_per_block_limit: 1024 threads_per_core_limit: 2048
  block_dim_limit_x: 2147483647 block_dim_limit_y: 65535 block_dim_limit_z: 65535
  thread_dim_limit_x: 1024 thread_dim_limit_y: 1024 thread_dim_limit_z: 64
  registers_per_core_limit: 65536 registers_per_block_limit: 65536
  shared_memory_per_block: 49152 shared_memory_per_core: 233472
  shared_memory_per_block_optin: 232448 l2_cache_size: 52428800
  device_memory_size: 84942979072 memory_bandwidth: 3352320000000 device_address_bits: 64
  driver_version: "12.8.0" runtime_version: "12.8.0" compile_time_toolkit_version: "12.8.0"
  dnn_version: "9.10.0"
}
"""
_OPERATION = re.compile(r" = (?:\(.*?\)|\S+) (fusion|copy|custom-call|conditional|while)\(")


def main() -> None:
    """Prints a JSON object of all programs."""
    [device] = topologies.get_topology_desc(
        "", "cuda", topology="1x1x1", target_config=_H100
    ).devices
    gpu.default_device = lambda: device  # What is traced for this device is asked here.
    told = {
        name: _counts(text, in_loop=name == "a chunk") for name, text in _programs(device).items()
    }
    print(json.dumps(told))


def _programs(device):
    """The optimised text of each program."""
    placed = jax.sharding.SingleDeviceSharding(device)

    def of(shape, dtype=jnp.float32):
        return jax.ShapeDtypeStruct(shape, dtype, sharding=placed)

    def like(tree):
        return jax.tree.map(lambda leaf: of(leaf.shape, leaf.dtype), tree)

    def compiled(function, *args):
        return function.lower(*args).compile().as_text()

    def walkers(hardcore):
        return like(jax.eval_shape(lambda s: jax_pool.new_walkers(s, hardcore), seeds))

    seeds = of((_LANES,), jnp.uint32)
    step = of((_LANES,), jnp.int32), of((_LANES, 4)), seeds
    agent = make_agent(AgentConfig())
    acting = batch_arrays.empty_acting(agent, _RUNS, jax.devices("cpu")[0])
    programs = compiled_batch.make_programs(agent, 1, 1)
    packed = jax.eval_shape(lambda a: programs.pack_behavior(a).rows, _train(agent))
    behavior = like(jax.eval_shape(programs.unpack_behavior, [packed]))
    begin = ChunkStart(
        active=of((_LANES,), jnp.bool_),
        needs_reset=of((_LANES,), jnp.bool_),
        left=of((_LANES,), jnp.int32),
        observation=of((_LANES, agent.layout.observation_size)),
    )
    chunk = jax.jit(functools.partial(device_stage._play, agent, _TICKS))
    finite = [of((_RUNS,), jnp.bool_)]
    rest = behavior, finite, begin, of((_LANES, _TICKS + 1), jnp.uint32), begin.left
    return {
        "a tick": compiled(jax_pool.tick, walkers(hardcore=False), *step),
        "a tick on hardcore terrain": compiled(jax_pool.tick, walkers(hardcore=True), *step),
        "a chunk": compiled(chunk, like(acting.state), like(acting.hyper), walkers(False), rest),
    }


def _train(agent):
    """Training states, packed."""
    words = jax.eval_shape(
        lambda: batch_arrays.empty_learner(agent, 2, 64, jax.devices("cpu")[0]).train
    )
    return jax.ShapeDtypeStruct((_RUNS, *words.shape[1:]), words.dtype)


def _counts(text, in_loop):
    """Of a program, or of the one loop that it is made of."""
    parts = dict(re.findall(r"^(?:ENTRY )?%?([\w.\-]+) \(.*?\{\n(.*?)^\}", text, re.M | re.S))
    [entry] = re.findall(r"^ENTRY %?([\w.\-]+)", text, re.M)
    if in_loop:
        [entry] = re.findall(r" while\(.*body=%?([\w.\-]+)", parts[entry])
    found = _OPERATION.findall(parts[entry])
    waits = found.count("conditional") + found.count("while")
    return {"kernels": len(found) - waits, "waits": waits}


if __name__ == "__main__":
    main()
