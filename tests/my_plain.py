"""A learner in plain JAX: its networks are lists of (weight, bias). It learns nothing."""

import dataclasses

import jax
import jax.numpy as jnp
from flax import struct


@struct.dataclass
class PlainState:
    actor: list
    critic: list


@dataclasses.dataclass(frozen=True)
class Plain:
    observation_size: int
    action_size: int
    policy_delay: int = 1
    noise_size: int = 1
    options: tuple = ()

    def init(self, actor_key, critic_key):
        def layers(key, sizes):
            keys = jax.random.split(key, len(sizes))
            return [
                (0.1 * jax.random.normal(k, s), jnp.zeros(s[1]))
                for k, s in zip(keys, sizes, strict=True)
            ]

        return PlainState(
            layers(actor_key, [(self.observation_size, 8), (8, self.action_size)]),
            layers(critic_key, [(self.observation_size + self.action_size, 1)]),
        )

    def with_networks(self, state, actor, critic):
        return PlainState(actor, critic)

    def act(self, hyper, actor, observation, noise, scale):
        for weight, bias in actor:
            observation = jnp.tanh(observation @ weight + bias)
        return observation + scale * noise

    def targets(self, hyper, state, batch, noise):
        return batch.reward

    def improve(self, hyper, state, batch, target, noise, last):
        return state, {"mean_target": jnp.mean(target)}


def plain(config):
    return Plain(config.observation_size, config.action_size)
