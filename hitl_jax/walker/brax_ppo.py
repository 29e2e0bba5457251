"""Brax's own PPO on our walker: an example of what else it is for; nothing here is tuned."""

import dataclasses
import warnings
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from hitl_jax.choices.checks import MOST_SEED, require_whole
from hitl_jax.errors import InvalidValue
from hitl_jax.walker.brax_env import BipedalWalker
from hitl_jax.walker.env import MOST_STEPS

with warnings.catch_warnings():
    # What Brax's own imports say.
    warnings.simplefilter("ignore")
    from brax.training.agents.ppo.train import train


@dataclasses.dataclass(frozen=True)
class PpoOptions:
    """Train a walker with Brax's PPO, and tell how it gets on.

    Attributes:
        steps: environment steps.
        walkers: walkers that are stepped at once; a multiple of 16.
        unroll: steps of each between two updates.
        evaluations: how often it is tested on the way, the beginning included; 0 is never.
        test_walkers: episodes of a test.
        seed: of everything.
    """

    steps: int = 5_000_000
    walkers: int = 256
    unroll: int = 32
    evaluations: int = 10
    test_walkers: int = 64
    seed: int = 0

    def checked(self) -> "PpoOptions":
        """Checks every option; returns itself.

        Raises:
            InvalidValue: one line with the name, the value and what is allowed.
        """
        for name in ("steps", "walkers", "unroll", "test_walkers"):
            require_whole(name, getattr(self, name), at_least=1)
        require_whole("evaluations", self.evaluations)
        require_whole("seed", self.seed, at_most=MOST_SEED)
        if self.walkers % 16:
            raise InvalidValue("walkers", self.walkers, "must be a multiple of 16")
        return self


def _replicated(tree: Any, devices: Sequence[jax.Device]) -> Any:
    """What `jax.device_put_replicated` gave: a leading axis of devices, a copy on each."""
    sharding = NamedSharding(Mesh(np.array(devices), ("devices",)), PartitionSpec("devices"))
    return jax.tree.map(
        lambda leaf: jax.device_put(jnp.stack([leaf] * len(devices)), sharding), tree
    )


def run(options: PpoOptions, tell: Callable[[int, dict[str, Any]], None]) -> Any:
    """Trains.

    Args:
        options: how.
        tell: is given the environment steps so far and Brax's metrics.

    Returns:
        What was learned: Brax's statistics of observations, the policy's parameters, the value's.
    """
    if not hasattr(jax, "device_put_replicated"):
        # JAX 0.10 took it away, Brax 0.14.2 calls it: https://github.com/google/brax/issues/671
        jax.device_put_replicated = _replicated  # type: ignore[assignment]
    minibatches = 8
    _, params, _ = train(
        BipedalWalker(),
        num_timesteps=options.steps,
        num_envs=options.walkers,
        episode_length=MOST_STEPS,
        unroll_length=options.unroll,
        batch_size=max(options.walkers // minibatches, 1),
        num_minibatches=minibatches,
        num_updates_per_batch=8,
        learning_rate=3e-4,
        entropy_cost=1e-3,
        discounting=0.99,
        gae_lambda=0.95,
        reward_scaling=0.1,
        normalize_observations=True,
        clipping_epsilon=0.2,
        seed=options.seed,
        num_evals=options.evaluations,
        num_eval_envs=options.test_walkers,
        run_evals=options.evaluations > 0,
        progress_fn=tell,
    )
    return params
