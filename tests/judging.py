"""Judgements of a simulated human, step by step."""

import functools

import hypothesis
import jax
import jax.numpy as jnp
import numpy as np

from hitl_jax import human

KEY = jax.random.key(0)


FALSE = jnp.zeros((), bool)


STILL = jnp.zeros(24)


DELAYED, ATTENTIVE = human.delayed(9), human.attentive()


SIMULATED = human.simulated_human()


outcome = jax.jit(human.outcome_dangerous)


quick = hypothesis.settings(max_examples=40, deadline=None, derandomize=True)


def bools(text):
    return np.array([letter == "1" for letter in text])


def observation(angle, velocity=0.0):
    """Of a hull at `angle` [rad] that turns at `velocity` [rad/s]."""
    return jnp.zeros(24).at[0].set(angle).at[1].set(velocity / 25)


def judge(part, params, dangerous, state=None, eager=True):
    """Feeds judgements [T] to a part, and lets an intervention begin where the part agrees.

    Returns:
        The part's judgements [T] and its last state.
    """
    state = part.init() if state is None else state
    state, after = scan_judgements(part, params, jnp.asarray(dangerous), state, eager)
    return np.asarray(after), state


@functools.partial(jax.jit, static_argnames="part")
def scan_judgements(part, params, dangerous, state, eager):
    def step(state, inputs):
        key, before = inputs
        state, after = part.judge(state, params, STILL, before, key)
        return part.notify(state, params, jnp.logical_and(after, eager)), after

    return jax.lax.scan(step, state, (jax.random.split(KEY, len(dangerous)), dangerous))


def run_part(part, params, key, num_steps, angles=None):
    """A part's judgements [T] of a hull at `angles` [T], without interventions."""
    angles = jnp.zeros(num_steps) if angles is None else angles
    return scan_angles(part, params, key, angles)


@functools.partial(jax.jit, static_argnames="part")
def scan_angles(part, params, key, angles):
    def step(state, inputs):
        key, angle = inputs
        state, dangerous = part.judge(state, params, observation(angle), FALSE, key)
        return part.notify(state, params, FALSE), dangerous

    return jax.lax.scan(step, part.init(), (jax.random.split(key, len(angles)), angles))[1]
