"""What a part's functions give, found by types and shapes alone, and whether that is as it must be.

`jax.eval_shape` runs a function on arrays without numbers, as a compiled program would: it finds
what does not fit, and what decides by a number with `if`, and computes nothing.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import chex
import jax
import jax.numpy as jnp
import numpy as np

from hitl_jax.config import RunHyper, typed
from hitl_jax.errors import InvalidValue, blamed_on
from hitl_jax.human import HumanParams
from hitl_jax.human.caller_state import form
from hitl_jax.team.parts import Agent
from hitl_jax.xla.threefry import make_key


class Blamed(NamedTuple):
    """The part that is at fault if something is: what messages begin with.

    Attributes:
        option: by which it was chosen.
        told: its name.
    """

    option: str
    told: str

    def shapes(self, function: Callable[..., Any], *given: Any) -> Any:
        """What a function gives, as shapes.

        Args:
            function: of the part.
            *given: its arguments, arrays or shapes.

        Raises:
            InvalidValue: one line, if it raises, or gives what no program could.
        """
        with blamed_on(*self):
            return jax.eval_shape(function, *given)

    def refuse(self, why: str) -> InvalidValue:
        """The error for this part.

        Args:
            why: what is wrong with it.
        """
        return InvalidValue(*self, why)

    def require(self, got: Any, what: str, shape: tuple[int, ...] = (), real: bool = True) -> None:
        """Refuses what is no array of this kind.

        Args:
            got: what the part gave.
            what: it must give, in words.
            shape: it must have.
            real: whether it must be real numbers, else truth values.
        """
        kinds = (np.floating, np.integer, np.bool_) if real else (np.bool_,)
        sound = hasattr(got, "dtype") and any(jnp.issubdtype(got.dtype, kind) for kind in kinds)
        if not sound or got.shape != shape:
            raise self.refuse(f"must give {what}, gives {form(got)}")

    def require_same(self, what: str, before: Any, after: Any) -> None:
        """Refuses a state that is of another structure, or whose arrays are of another kind.

        Args:
            what: gave the state, in words.
            before: the state that was.
            after: the state that it gave.
        """
        known: Any = jax.tree.structure(before)
        if jax.tree.structure(after) != known:
            raise self.refuse(f"{what} must give a state like that of init, gives {form(after)}")
        for old, new in zip(jax.tree.leaves(before), jax.tree.leaves(after), strict=True):
            if form(old) != form(new):
                raise self.refuse(f"{what} makes {form(new)} of a {form(old)} of the state")


class Given(NamedTuple):
    """What the functions of a team's parts are called with, for one run.

    Attributes:
        hyper: hyperparameters, with the options of all parts.
        seen: an observation, [O].
        noise: of an action, [A].
        key: a key, [].
        number: any float32, [].
        flag: any truth value, [].
    """

    hyper: RunHyper
    seen: jax.ShapeDtypeStruct
    noise: jax.ShapeDtypeStruct
    key: jax.ShapeDtypeStruct
    number: jax.ShapeDtypeStruct
    flag: jax.ShapeDtypeStruct


class Sizes(NamedTuple):
    """What the types and shapes depend on that a team's parts are called with; hashable.

    Attributes:
        observation_size: O.
        action_size: A.
        batch_size: B.
        extra: names of the options of a team's parts.
        human_extra: names of the human's.
    """

    observation_size: int
    action_size: int
    batch_size: int
    extra: tuple[str, ...]
    human_extra: tuple[str, ...]


def sizes_of(agent: Agent) -> Sizes:
    """Those of a team."""
    config, hyper = agent.config, agent.with_extra(RunHyper())
    sizes = config.observation_size, config.action_size, config.batch_size
    return Sizes(*sizes, tuple(sorted(hyper.extra)), tuple(sorted(hyper.human.extra)))


def given_of(sizes: Sizes) -> Given:
    """What the parts of a team are called with."""
    human = HumanParams(extra=dict.fromkeys(sizes.human_extra, 0.0))
    return Given(
        hyper=typed(RunHyper(human=human, extra=dict.fromkeys(sizes.extra, 0.0))),
        seen=floats(sizes.observation_size),
        noise=floats(sizes.action_size),
        key=jax.eval_shape(lambda: make_key(0)),
        number=floats(),
        flag=jax.ShapeDtypeStruct((), bool),
    )


def floats(*shape: int) -> jax.ShapeDtypeStruct:
    """An array of float32."""
    return jax.ShapeDtypeStruct(shape, jnp.float32)


def many(tree: chex.ArrayTree, count: int = 2) -> chex.ArrayTree:
    """A pytree with an axis of so many runs before all others."""
    return jax.tree.map(
        lambda leaf: jax.ShapeDtypeStruct((count, *jnp.shape(leaf)), leaf.dtype), tree
    )
