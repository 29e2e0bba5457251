"""The alarm, the Δ rule and the reward of an alarm: lines 7 and 8 of Algorithm 1."""

import chex
import jax.numpy as jnp


def alarm(safety_indicator: chex.Array, boundary: chex.Array) -> chex.Array:
    """C = {c_t ≥ |τ_t| or c_t ≤ −|τ_t|} (line 7).

    Args:
        safety_indicator: c_t, [].
        boundary: τ_t in the same unit, [].

    Returns:
        Whether the alarm is raised, bool [].
    """
    chex.assert_equal_shape([safety_indicator, boundary])
    return jnp.abs(safety_indicator) >= jnp.abs(boundary)


def next_boundary(
    boundary: chex.Array,
    alarmed: chex.Array,
    dangerous: chex.Array,
    delta_minus: chex.Array,
    delta_plus: chex.Array,
) -> chex.Array:
    """τ_{t+1}: τ_t − Δ⁻ after a true alarm, τ_t + Δ⁺ after a false one, else τ_t (line 8).

    The drift is Δ⁺ P(C, h=1) − Δ⁻ P(C, h=0): the boundary settles where the share of true alarms is
    Δ⁺ / (Δ⁻ + Δ⁺). The paper has Δ⁻ = Δ⁺ = 0.001.

    Args:
        boundary: τ_t, [].
        alarmed: C, bool [].
        dangerous: h_t = 0, bool [].
        delta_minus: Δ⁻, [].
        delta_plus: Δ⁺, [].

    Returns:
        τ_{t+1}, [].
    """
    change = jnp.where(dangerous, -delta_minus, delta_plus)
    return boundary + jnp.where(alarmed, change, 0.0)


def boundary_reward(
    alarmed: chex.Array,
    dangerous: chex.Array,
    alarm_reward: chex.Array,
    human_price: chex.Numeric = 0.0,
) -> chex.Array:
    """r'_t: +ρ − p for a true alarm, −ρ for a false one, 0 otherwise (line 8, and section III).

    Args:
        alarmed: C, bool [].
        dangerous: h_t = 0, bool [].
        alarm_reward: ρ, []; 0 gives the bare equation (7).
        human_price: p, what it costs that the human comes, [].

    Returns:
        r'_t, [].
    """
    judged = jnp.where(dangerous, alarm_reward - human_price, -alarm_reward)
    return jnp.where(alarmed, judged, 0.0)
