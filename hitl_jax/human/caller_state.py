"""What a human or another part remembers, as a caller wrote it, made fit for a program.

A state is a pytree of arrays whose types stay as they are at the start of a run. A caller may write
plain numbers; types of 64 bits, which are all that Python and NumPy have by default, become those
of 32, whatever JAX is configured to.
"""

from typing import Any

import chex
import jax
import jax.numpy as jnp
import numpy as np

from hitl_jax.errors import name_of

_NARROWER = {"int64": jnp.int32, "uint64": jnp.uint32, "float64": jnp.float32}
_ALLOWED = "arrays or numbers: bool, whole or real of up to 32 bits, or typed keys"


def begun(owner: str, state: Any) -> chex.ArrayTree:
    """A state at the start of a run, as arrays.

    Args:
        owner: whose, for the message.
        state: a pytree of what `_ALLOWED` says.

    Raises:
        ValueError: one line, for a leaf that is something else.
    """
    return jax.tree.map(lambda leaf: _array(owner, leaf), state)


def kept(owner: str, state: Any, before: chex.ArrayTree) -> chex.ArrayTree:
    """A state after a step, with the types that it had before.

    Args:
        owner: whose, for the message.
        state: a pytree of the same structure and shapes.
        before: arrays.

    Raises:
        ValueError: one line, if the structure is another, or a leaf has another shape or a type
            whose values the one before does not have.
    """
    structure: Any = jax.tree.structure(state)
    known = jax.tree.structure(before)
    if structure != known:
        raise ValueError(f"state of {owner}: was {known} and is {structure}; must stay the same")

    def as_before(leaf: Any, old: chex.Array) -> chex.Array:
        new = _array(owner, leaf)
        fits = _is_key(new) == _is_key(old)
        if fits and not _is_key(new):
            weak = getattr(leaf, "weak_type", isinstance(leaf, bool | int | float))
            fits = jnp.result_type(leaf if weak else new, old) == old.dtype
        if new.shape != old.shape or not fits:
            raise ValueError(
                f"state of {owner}: a leaf was {form(old)} and is {form(new)}; must be from the "
                "start what it becomes"
            )
        return new if _is_key(new) else jnp.asarray(new, old.dtype)

    return jax.tree.map(as_before, state, before)


def form(state: Any) -> str:
    """What a state is made of, in a few words: `float32[3]`, or `dict`."""
    if not (hasattr(state, "dtype") and hasattr(state, "shape")):
        return name_of(state)
    return f"{state.dtype}{list(state.shape)}"


def _array(owner: str, leaf: Any) -> chex.Array:
    array = leaf if isinstance(leaf, jax.Array) else np.asarray(leaf)
    if _is_key(array):
        return array
    number = jnp.issubdtype(array.dtype, np.bool_) or (
        jnp.issubdtype(array.dtype, np.number) and jnp.isrealobj(array)
    )
    if not number:
        raise ValueError(f"state of {owner} holds {leaf!r}: must be {_ALLOWED}")
    dtype = _NARROWER.get(array.dtype.name, array.dtype)
    if isinstance(array, np.ndarray) and jnp.issubdtype(dtype, np.integer):
        limits = jnp.iinfo(dtype)
        if array.size and not (limits.min <= array.min() and array.max() <= limits.max):
            raise ValueError(f"state of {owner} holds {leaf!r}: must be {_ALLOWED}")
    return jnp.asarray(array, dtype)


def _is_key(leaf: Any) -> bool:
    return jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key)
