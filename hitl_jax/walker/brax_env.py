"""The walker as a Brax environment: any of Brax's agents can train on it."""

import warnings

import jax
import jax.numpy as jnp

from hitl_jax.walker import env

with warnings.catch_warnings():
    # Brax's own imports warn.
    warnings.simplefilter("ignore")
    from brax.envs.base import Env, State


class BipedalWalker(Env):
    """BipedalWalker-v3 for Brax's wrappers and agents.

    `done` is a fall or the goal. Brax's wrappers keep the time limit: give them an `episode_length`
    of `MOST_STEPS`. Brax's automatic reset repeats a walker's first terrain in all its episodes.

    Attributes:
        hardcore: whether terrain has stumps, stairs and pits (BipedalWalkerHardcore-v3, whose limit
            is `MOST_HARDCORE_STEPS`).
    """

    def __init__(self, hardcore: bool = False):
        """Chooses the terrain; see the attributes."""
        self.hardcore = hardcore

    def reset(self, rng: jax.Array) -> State:
        """Begins an episode on new terrain.

        Args:
            rng: a JAX key, consumed.

        Returns:
            The first state; its observation is [24].
        """
        walker, observation = env.reset(rng, self.hardcore)
        zero = jnp.zeros((), jnp.float32)
        return State(walker, observation, zero, zero)

    def step(self, state: State, action: jax.Array) -> State:
        """One step of 0.02 s.

        Args:
            state: before the step.
            action: [4], clipped to [-1, 1].

        Returns:
            The state after the step.
        """
        walker, step = env.step(state.pipeline_state, action)
        return state.replace(  # type: ignore[attr-defined, no-any-return, unused-ignore]
            pipeline_state=walker,
            obs=step.observation,
            reward=step.reward,
            done=step.terminated.astype(jnp.float32),
        )

    @property
    def observation_size(self) -> int:
        """Length of an observation, 24."""
        return env.OBSERVATION_SIZE

    @property
    def action_size(self) -> int:
        """Length of an action, 4."""
        return env.ACTION_SIZE

    @property
    def backend(self) -> str:
        """Name of the physics that Brax shows: our own."""
        return "hitl_jax"
