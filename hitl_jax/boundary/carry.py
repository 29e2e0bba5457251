"""What a boundary source remembers, made one array that can be saved with a run."""

import chex
import jax
import jax.numpy as jnp

from hitl_jax.boundary.sources import BoundarySource, Move
from hitl_jax.human import caller_state

_OWNER = "the boundary source"


def first_carry(source: BoundarySource, initial: chex.Array) -> chex.Array:
    """What a boundary source begins a run with, float32 [] or [K].

    Args:
        source: of the team.
        initial: τ_0, [].

    Raises:
        ValueError: one line, if it is anything else.
    """
    carry = caller_state.begun(_OWNER, source.init(initial))
    sound = isinstance(carry, jax.Array) and carry.dtype == jnp.float32 and carry.ndim < 2
    if not sound:
        raise ValueError(
            f"state of {_OWNER}: {caller_state.form(carry)}: must be float32, [] or [K]"
        )
    return carry


def next_carry(source: BoundarySource, carry: chex.Array, move: Move) -> chex.Array:
    """What a boundary source remembers after a step, of the same shape.

    Args:
        source: of the team.
        carry: before it.
        move: what the step told.

    Raises:
        ValueError: one line, if it is of another kind than before.
    """
    after: chex.Array = caller_state.kept(_OWNER, source.advance(carry, move), carry)
    return after
