"""Boundary sources by name: where the boundary τ_t of a step comes from.

To add one, write a `BoundarySource` and register it.
"""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import chex
import jax.numpy as jnp

from hitl_jax.choices.options import Option, options_of
from hitl_jax.choices.registry import Registry


class Move(NamedTuple):
    """What a step tells a boundary source.

    Attributes:
        boundary: τ_t, [].
        following: τ_{t+1} of line 8, within the bounds, [].
        alarmed: C, bool [].
        control: u_t, bool [].
        step: Δ⁺, [].
        target_rate: what `quantile` and `pid` aim at, a share of the steps, [].
        low: least boundary, [].
        high: greatest boundary, [].
        extra: the run's numbers of the choices' own, by name, each [].
    """

    boundary: chex.Array
    following: chex.Array
    alarmed: chex.Array
    control: chex.Array
    step: chex.Array
    target_rate: chex.Array
    low: chex.Array
    high: chex.Array
    extra: Mapping[str, chex.Array] = {}


class BoundarySource(NamedTuple):
    """How τ_t is computed: from the network, from the value that line 8 moves, or by another rule.

    `carry` lasts over the episodes of a run: one array of float32, [] or [K], whose shape stays as
    it is. (A plain `float`, or an array of float64, is made one.) It is saved with the run, and
    beside its networks as `boundary`.

    Attributes:
        init: maps τ_0 to the first carry.
        boundary: maps (carry, π_θ(s_t)) to τ_t.
        advance: maps (carry, what the step told) to the next carry. A test is frozen: Δ⁺ is 0, and
            the carry should stay as it is.
        options: traced numbers of its own, in `Move.extra`.
        executes_actor: whether τ_t comes from π_θ(s_t).
    """

    init: Callable[[chex.Array], chex.Array]
    boundary: Callable[[chex.Array, chex.Array], chex.Array]
    advance: Callable[[chex.Array, Move], chex.Array]
    options: tuple[Option, ...] = ()
    executes_actor: bool = False


SOURCES: Registry[BoundarySource] = Registry(
    "boundary source",
    "boundary_source",
    lambda value: isinstance(value, BoundarySource),
    require=options_of,
)


@SOURCES.register("network", "π_θ(s_t); line 8 enters the TD target only")
def network() -> BoundarySource:
    """τ_t = π_θ(s_t); τ_{t+1} enters the TD target only (the literal reading)."""
    return BoundarySource(
        init=jnp.zeros_like,
        boundary=lambda carry, network: network,
        advance=lambda carry, move: carry,
        executes_actor=True,
    )


@SOURCES.register(
    "residual",
    "π_θ(s_t) plus the sum of line 8's steps; the actor is improved at π_θ(s_t), as in line 12",
)
def residual() -> BoundarySource:
    """τ_t = π_θ(s_t) + b_t, where b_t gathers line 8's steps."""
    return BoundarySource(
        init=jnp.zeros_like,
        boundary=lambda carry, network: network + carry,
        advance=lambda carry, move: carry + move.following - move.boundary,
        executes_actor=True,
    )


@SOURCES.register("rule", "the scalar that line 8 moves")
def rule() -> BoundarySource:
    """τ is the scalar that line 8 moves; the networks are trained but not executed."""
    return BoundarySource(
        init=lambda initial: initial,
        boundary=lambda carry, network: carry,
        advance=lambda carry, move: move.following,
    )


_QUANTILE_GAIN = 10.0  # in units of Δ⁺: where alarms are rare, τ must come down between them


@SOURCES.register("quantile", "holds the share of alarms at a target")
def quantile() -> BoundarySource:
    """τ follows that quantile of |c| which a target share of the steps exceeds.

    As the thresholds of ThriftyDAgger (https://arxiv.org/abs/2109.08273, section 4.3), but followed
    step by step; nobody's judgement moves it.
    """

    def advance(carry: chex.Array, move: Move) -> chex.Array:
        change = _QUANTILE_GAIN * move.step * (move.alarmed - move.target_rate)
        return jnp.clip(carry + change, move.low, move.high)

    return BoundarySource(
        init=lambda initial: initial,
        boundary=lambda carry, network: carry,
        advance=advance,
    )


_PID_SMOOTHING = 2000.0  # steps over which the error of the rate is averaged
_PROPORTIONAL, _DERIVATIVE = 1e4, 1e4  # Gains in units of Δ⁺; that of the integral is 1.


@SOURCES.register("pid", "holds the share of steps under human control at a target")
def pid() -> BoundarySource:
    """A PID controller holds the share of steps under human control at a target.

    As the multiplier of the takeover cost in EGPO (https://arxiv.org/abs/2110.06831); here τ stands
    in its place: the human is in control too often, and τ grows.
    """

    def boundary(carry: chex.Array, network: chex.Array) -> chex.Array:
        del network
        initial, integral, error, change = carry
        return initial + integral + _PROPORTIONAL * error + _DERIVATIVE * change

    def advance(carry: chex.Array, move: Move) -> chex.Array:
        initial, integral, error, _ = carry
        now = move.step * (move.control - move.target_rate)
        change = (now - error) / _PID_SMOOTHING
        # An integral out of the boundary's range would have to be unwound again.
        integral = jnp.clip(integral + now, move.low - initial, move.high - initial)
        after = jnp.stack([initial, integral, error + change, change])
        return jnp.where(move.step > 0, after, carry)  # A test is frozen by Δ⁺ = 0.

    return BoundarySource(
        init=lambda initial: jnp.stack([initial, *[jnp.zeros_like(initial)] * 3]),
        boundary=boundary,
        advance=advance,
    )
