"""SAC (https://arxiv.org/abs/1801.01290) from outside the package: one file, one protocol."""

import dataclasses

import chex
import flax.linen as nn
import jax
import jax.numpy as jnp
import optax
from flax import struct

from hitl_jax.choices.options import Option
from hitl_jax.learner import adam, losses, networks


class Gaussian(nn.Module):
    """Mean and logarithm of the standard deviation of an action before it is squashed."""

    hidden_sizes: tuple[int, ...]
    action_size: int

    @nn.compact
    def __call__(self, observation):
        x = observation
        for size in self.hidden_sizes:
            x = nn.relu(nn.Dense(size)(x))
        mean, log_std = jnp.split(nn.Dense(2 * self.action_size)(x), 2, axis=-1)
        return mean, jnp.clip(log_std, -5.0, 2.0)


@struct.dataclass
class SacState:
    actor: chex.ArrayTree
    critic: chex.ArrayTree
    target_critic: chex.ArrayTree
    actor_optimizer: chex.ArrayTree
    critic_optimizer: chex.ArrayTree


@dataclasses.dataclass(frozen=True)
class Sac:
    observation_size: int
    action_size: int
    hidden_sizes: tuple[int, ...]
    policy_delay: int = 1
    options: tuple[Option, ...] = (Option("temperature", 0.1, "weight of the entropy", "1", 0.0),)

    @property
    def noise_size(self):
        return 2 * self.action_size  # For the next action, and for the one that is improved.

    @property
    def actor(self):
        return Gaussian(self.hidden_sizes, self.action_size)

    @property
    def critic(self):
        return networks.Critics(self.hidden_sizes, 2, layer_norm=False)

    def init(self, actor_key, critic_key):
        observation = jnp.zeros((1, self.observation_size))
        actor = self.actor.init(actor_key, observation)
        critic = self.critic.init(critic_key, observation, jnp.zeros((1, self.action_size)))
        return SacState(actor, critic, critic, adam.init(actor), adam.init(critic))

    def with_networks(self, state, actor, critic):
        return dataclasses.replace(state, actor=actor, critic=critic, target_critic=critic)

    def act(self, hyper, actor, observation, noise, scale):
        mean, log_std = self.actor.apply(actor, observation)
        return jnp.tanh(mean + jnp.where(scale > 0, jnp.exp(log_std) * noise, 0.0))

    def sample(self, actor, observation, noise):
        """Actions [B, A] and the logarithm of their density [B]."""
        mean, log_std = self.actor.apply(actor, observation)
        action = jnp.tanh(mean + jnp.exp(log_std) * noise)
        log_density = -0.5 * jnp.square(noise) - log_std - 0.5 * jnp.log(2 * jnp.pi)
        squashed = jnp.log(1.0 - jnp.square(action) + 1e-6)
        return action, jnp.sum(log_density - squashed, axis=-1)

    def targets(self, hyper, state, batch, noise):
        noise = noise[:, : self.action_size]
        action, log_density = self.sample(state.actor, batch.next_observation, noise)
        next_q = self.critic.apply(state.target_critic, batch.next_observation, action)
        soft = next_q - hyper.extra["temperature"] * log_density
        return losses.target_q(batch.reward, batch.discount, soft)

    def improve(self, hyper, state, batch, target, noise, last):
        grads, metrics = jax.grad(losses.critic_loss, has_aux=True)(
            state.critic, self.critic.apply, batch, target
        )
        critic, critic_optimizer = adam.descend(
            state.critic, grads, state.critic_optimizer, hyper.critic_learning_rate
        )

        def actor_loss(actor):
            action, density = self.sample(actor, batch.observation, noise[:, self.action_size :])
            q = jnp.min(self.critic.apply(critic, batch.observation, action), axis=0)
            return jnp.mean(hyper.extra["temperature"] * density - q)

        loss, grads = jax.value_and_grad(actor_loss)(state.actor)
        actor, actor_optimizer = adam.descend(
            state.actor, grads, state.actor_optimizer, hyper.actor_learning_rate
        )
        step = hyper.target_step_size
        target_critic = optax.incremental_update(critic, state.target_critic, step)
        state = SacState(actor, critic, target_critic, actor_optimizer, critic_optimizer)
        return state, metrics | {"actor_loss": loss}


def sac(config):
    return Sac(config.observation_size, config.action_size, config.hidden_sizes)
