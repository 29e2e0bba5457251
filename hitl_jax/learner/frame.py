"""What is stored of one tick of one run, by name, and where each number stands in a packed row.

A tick is packed once, by `pack`, as `Frame` and behind it `Flags`. The replay keeps the frame; the
host also reads the flags until the episode has ended. A further number is one more line in `Frame`
or `Flags`, with its value where the tick is packed (`team.packed_decision`).
"""

import functools
from typing import Any, NamedTuple

import chex
import jax.numpy as jnp

GOES_ON, FALL, FINISHED, CUT_OFF = range(4)
"""What became of the machine's walk in a step, `Frame.event`: it went on; the walker fell; the
episode ended otherwise, so that no fall can follow; or what the machine would have come to is not
known, since time was up, or the human reset the walker or acted."""


class Frame(NamedTuple):
    """What the replay keeps of a tick.

    Attributes:
        observation: s_t, [O].
        action: the executed action, [A].
        reward: r_t of equation (7), []; known when the walker has answered.
        terminated: 1 where the step ended the episode and the bootstrap, []; likewise.
        truncated: 1 where the step ended the episode but not the bootstrap, []; likewise.
        final: 1 where no step was taken, since the episode had ended, [].
        boundary: τ_t, [].
        next_boundary: τ_{t+1} of line 8, [].
        boundary_reward: r'_t, [].
        event: one of `GOES_ON`, `FALL`, `FINISHED`, `CUT_OFF`, []; known when the walker has
            answered.
        explores: 1 with action noise or at random, where some episodes have no noise
            (`noise_free_every`), [].
    """

    observation: chex.Array
    action: chex.Array
    reward: chex.Numeric
    terminated: chex.Numeric
    truncated: chex.Numeric
    final: chex.Numeric
    boundary: chex.Numeric
    next_boundary: chex.Numeric
    boundary_reward: chex.Numeric
    event: chex.Numeric
    explores: chex.Numeric


class Flags(NamedTuple):
    """What else is known of a tick, each bool [...].

    Attributes:
        control: u_t, the human is in control.
        began: an intervention began.
        human_action: a^h was executed.
        human_reset: the human ended the episode after this step.
        alarmed: C, the alarm was raised.
        dangerous: h_t = 0, the human saw danger.
    """

    control: chex.Array
    began: chex.Array
    human_action: chex.Array
    human_reset: chex.Array
    alarmed: chex.Array
    dangerous: chex.Array


_VECTORS = ("observation", "action")
_SCALARS = tuple(name for name in (*Frame._fields, *Flags._fields) if name not in _VECTORS)


class Layout(NamedTuple):
    """Columns of a packed row, float32: `layout.reward` is the column of `Frame.reward`.

    Each field of `Frame` and of `Flags` is an attribute: a slice for `observation` and `action`, an
    index for the others.

    Attributes:
        observation_size: O.
        action_size: A.
    """

    observation_size: int
    action_size: int

    def __getattr__(self, name: str) -> Any:
        """The columns of a field of `Frame` or `Flags`."""
        places = _places(*self)
        if name not in places:
            raise AttributeError(f"a tick has no field {name!r}")
        return places[name]

    @property
    def width(self) -> int:
        """W: columns of a frame."""
        return self.observation_size + self.action_size + len(Frame._fields) - len(_VECTORS)

    @property
    def step_width(self) -> int:
        """Columns of a frame and its flags."""
        return self.width + len(Flags._fields)

    @property
    def without_observation(self) -> "Layout":
        """The layout of rows that begin with the action."""
        return self._replace(observation_size=0)


@functools.cache
def _places(observation_size: int, action_size: int) -> dict[str, int | slice]:
    seen = observation_size + action_size
    places: dict[str, int | slice] = {
        "observation": slice(0, observation_size),
        "action": slice(observation_size, seen),
    }
    return places | {name: seen + index for index, name in enumerate(_SCALARS)}


def pack(frame: Frame, flags: Flags) -> chex.Array:
    """A tick of one run as one row, float32 [`Layout.step_width`]."""
    named = {**frame._asdict(), **flags._asdict()}
    scalars = jnp.stack([jnp.asarray(named[name], jnp.float32) for name in _SCALARS])
    return jnp.concatenate([frame.observation, frame.action, scalars])


def flag_of(rows: chex.Array, layout: Layout, name: str) -> chex.Array:
    """A field of `Flags`, bool [...], from rows [..., `Layout.step_width`]."""
    return rows[..., getattr(layout, name)] > 0.5


def flags_of(rows: chex.Array, layout: Layout) -> Flags:
    """All of `Flags`, see `flag_of`."""
    flags = rows[..., layout.width : layout.step_width] > 0.5
    return Flags(*(flags[..., place] for place in range(len(Flags._fields))))
