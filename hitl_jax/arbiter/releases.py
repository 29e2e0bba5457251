"""What ends a takeover, by name."""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import chex

from hitl_jax.boundary import alarm
from hitl_jax.choices.options import options_of
from hitl_jax.choices.registry import Registry


class Takeover(NamedTuple):
    """What a release is decided by, at one step.

    Attributes:
        dangerous: h_t = 0, and the human is there, bool [].
        indicator: c_t, [].
        boundary: τ_t, [].
        release_share: the share of the boundary below which hysteresis lets go, [].
        extra: the run's numbers of the choices' own, by name, each [].
    """

    dangerous: chex.Array
    indicator: chex.Array
    boundary: chex.Array
    release_share: chex.Array
    extra: Mapping[str, chex.Array]


Release = Callable[[Takeover], chex.Array]
"""Maps what is seen to whether a takeover goes on, bool []."""

RELEASES: Registry[Release] = Registry("release", "release", callable, require=options_of)


@RELEASES.register("judgement", "the human judges the state safe")
def judgement(now: Takeover) -> chex.Array:
    """A takeover goes on as long as the human sees danger."""
    return now.dangerous


@RELEASES.register("hysteresis", "|c_t| is below a share of the boundary")
def hysteresis(now: Takeover) -> chex.Array:
    """It goes on as long as |c_t| is at least a share of the boundary.

    As LazyDAgger (https://arxiv.org/abs/2104.00053).
    """
    return alarm(now.indicator, now.release_share * now.boundary)
