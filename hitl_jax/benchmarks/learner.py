"""The learner beside the machine's own matrix product."""

import dataclasses
import itertools
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from hitl_jax.benchmarks.timing import best
from hitl_jax.config import LAST, AgentConfig, Hyper, Method, hyper_for, typed
from hitl_jax.learner import replay
from hitl_jax.learner.deterministic import DeterministicActorCritic
from hitl_jax.results.episode_measures import Row
from hitl_jax.team.agent import make_agent
from hitl_jax.training import batch_arrays, compiled_batch
from hitl_jax.training.run_spec import LoopConfig, num_slots
from hitl_jax.xla.dense_product import MATMUL_PRECISIONS
from hitl_jax.xla.devices import default_tile, learning_devices
from hitl_jax.xla.threefry import make_key

PRODUCT_SIZE = 2048
RUNS = 30
_LOOP = LoopConfig()


def update_flops(config: AgentConfig) -> float:
    """Matrix-product FLOPs that one update of one run cannot do without, from the shapes.

    Counted: target actor and target critics forward; critics forward and backward without the
    gradient of their input; at every `policy_delay`-th update the actor forward and backward
    without the gradient of its input, and one critic forward and back to the action alone.
    """

    def layers(inputs: int, outputs: int) -> list[int]:
        sizes = [inputs, *config.hidden_sizes, outputs]
        return [a * b for a, b in itertools.pairwise(sizes)]

    observations, actions = config.observation_size, config.action_size
    actor = layers(observations, actions)
    learner = config.task_learner
    assert isinstance(learner, DeterministicActorCritic)
    critic = layers(observations + actions, learner.num_quantiles or 1)
    target = sum(actor) + learner.num_critics * sum(critic)
    critics = learner.num_critics * (3 * sum(critic) - critic[0])
    to_action = sum(critic[1:]) + actions * config.hidden_sizes[0]
    policy = (3 * sum(actor) - actor[0]) + sum(critic) + to_action
    return 2.0 * config.batch_size * (target + critics + policy / learner.policy_delay)


def measure_product(seconds: float, precision: str = "float32") -> float:
    """Matrix product over all cores, of operands of some precision, with float32 sums [FLOP/s]."""
    n = PRODUCT_SIZE
    x = jnp.ones((n, n), precision)
    product = jax.jit(lambda a: jnp.matmul(a, a, preferred_element_type=jnp.float32))
    return 2.0 * n**3 / best(lambda: product(x), seconds)


def measure_learner(seconds: float) -> list[Row]:
    """Updates/s and GFLOP/s beside the product's rate: sizes that have a bar, and the default.

    The same again with hidden layers multiplied in bfloat16, beside such a product.
    """
    plain = AgentConfig(
        learner="td3", human_data="transitions", tested_actor=LAST, layer_norm=False
    )
    wide = dataclasses.replace(plain, hidden_sizes=(256, 256), batch_size=256)
    narrow = dataclasses.replace(plain, hidden_sizes=(128, 128), batch_size=128)
    peaks = {precision: measure_product(seconds, precision) for precision in MATMUL_PRECISIONS}
    rows = [
        _learner_row(wide, 12, 0.45, seconds),
        _learner_row(wide, RUNS, 0.60, seconds),
        _learner_row(narrow, RUNS, 0.50, seconds),
        _learner_row(AgentConfig(), RUNS, None, seconds),
    ]
    for config in (wide, narrow, AgentConfig()):
        rounded = dataclasses.replace(config, matmul_precision="bfloat16")
        rows.append(_learner_row(rounded, RUNS, None, seconds))
    # The machine may have been faster or slower meanwhile: the higher figure is the bound.
    peaks = {name: max(peak, measure_product(seconds, name)) for name, peak in peaks.items()}
    for row in rows:
        peak = peaks[row["precision"]]
        row["product GFLOP/s"] = round(peak / 1e9, 1)
        row["ratio"] = round(row["GFLOP/s"] * 1e9 / peak, 3)
    return rows


def make_learner(
    config: AgentConfig, runs: int, num_updates: int, loop: LoopConfig = _LOOP
) -> Callable[[], list[jax.Array]]:
    """A call that makes `num_updates` updates of each run, from a full replay.

    Args:
        config: static choices.
        runs: a multiple of the devices' number.
        num_updates: of each run and call.
        loop: the size of the replay, and of what each call adds to it.
    """
    agent = make_agent(config)
    programs = compiled_batch.make_programs(agent, num_updates, default_tile(runs))
    hyper = typed(agent.with_extra(hyper_for(Method.HITL_AC, Hyper())))
    layout = agent.layout
    share = runs // len(learning_devices())
    rng = np.random.default_rng(0)
    past = rng.standard_normal((share, loop.frames, layout.width), np.float32)
    past[:, :, layout.terminated : layout.final + 1] = 0.0
    add = jax.jit(replay.add, donate_argnums=0)
    seats = []
    for device in learning_devices():
        empty = batch_arrays.empty_learner(agent, share, loop.frames, device)
        for column in range(share):
            train, _ = jax.device_get(programs.begin(make_key(column)))
            empty = programs.begin_learning(empty, column, hyper, train)
        seats.append(empty._replace(memory=add(empty.memory, past)))
    frames = past[:, : loop.chunk].copy()
    slots = np.arange(share, dtype=np.int32)

    def learn() -> list[jax.Array]:
        for index, before in enumerate(seats):
            seats[index], _ = programs.learn(before, frames, slots, np.int32(share))
        return [after.train for after in seats]

    return learn


def _learner_row(config: AgentConfig, runs: int, bar: float | None, seconds: float) -> Row:
    runs, num_updates = num_slots(runs, runs), 8
    rate = runs * num_updates / best(make_learner(config, runs, num_updates), seconds)
    return {
        "network": "x".join(map(str, config.hidden_sizes)),
        "batch": config.batch_size,
        "norm": "yes" if config.layer_norm else "no",
        "precision": config.matmul_precision,
        "runs": runs,
        "updates/s": round(rate),
        "GFLOP/s": round(rate * update_flops(config) / 1e9, 1),
        "product GFLOP/s": 0.0,
        "ratio": 0.0,
        "bar": "" if bar is None else bar,
    }
