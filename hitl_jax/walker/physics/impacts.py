"""What becomes of parts that meet the ground within a step.

The rest of a step after an impact is made by the part alone, apart from its hinges, as Box2D does
it; the hinges are put together again in the next step. Arrays are [slots, parts, B] where not said
otherwise, those of parts alone [parts, B].

Source: E. Catto, "Continuous Collision", GDC 2013, and the behaviour of Box2D 2.3's
`b2World::SolveTOI`.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from hitl_jax.walker import constants
from hitl_jax.walker.geometry import Speeds, Vec, dot, pose, where
from hitl_jax.walker.physics import contact_solver, manifolds
from hitl_jax.walker.physics.boxes import Near
from hitl_jax.walker.physics.manifolds import Contacts
from hitl_jax.walker.physics.time_of_impact import Sweep, time_of_impact

_MOST_IMPACTS = 8
"""Of one contact in a step."""
_FIRMNESS, _POSITION_ROUNDS, _GOOD_ENOUGH = 0.75, 20, -1.5 * constants.LINEAR_SLOP
_STILL = 1e-6
"""Velocity rounds that change no velocity by more [m/s, rad/s] are the last: a part alone with the
ground needs few of its 180."""
_ALL = 1.0 - 10 * float(np.finfo(np.float32).eps)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Moved:
    """The legs' parts within a step.

    Attributes:
        sweep: from where they are at a time of the step to where they end.
        done: that time, a share of the step.
        speeds: their velocities.
        contacts: with the ground.
        feet: whether the parts stand, bool [parts, B].
    """

    sweep: Sweep
    done: jax.Array
    speeds: Speeds
    contacts: Contacts
    feet: jax.Array


def land(moved: Moved, near: Near) -> Moved:
    """Has parts meet the ground, one impact after the other.

    Args:
        moved: parts at the beginning of a step, as they would end without the ground.
        near: what is where they would end.

    Returns:
        The parts at its end.
    """

    def goes(carry: tuple) -> jax.Array:
        more: jax.Array = carry[-1]
        return more

    def one(carry: tuple) -> tuple:
        moved, count, off, _ = carry
        moments = _next(moved, near, count, off)
        moment = moments.min(0)
        meets = moment < _ALL
        first = meets & (moments == moment) & (count <= _MOST_IMPACTS)
        after, touched = _impact(moved, near, moment, first)
        lands = meets & touched
        moved = jax.tree.map(lambda new, old: jnp.where(lands, new, old), after, moved)
        return moved, count + first, off | (first & ~touched), meets.any()

    count, off = jnp.zeros_like(near.index), jnp.zeros_like(near.index, bool)
    moved, *_ = jax.lax.while_loop(goes, one, (moved, count, off, jnp.bool_(True)))
    return moved


def _next(moved: Moved, near: Near, count: jax.Array, off: jax.Array) -> jax.Array:
    """When each contact's next impact is, as shares of the whole step."""
    beta = time_of_impact(moved.sweep, near)
    time = jnp.minimum(moved.done + (1.0 - moved.done) * beta, 1.0)
    counts = (beta < 1.0) & ~off & (count <= _MOST_IMPACTS)
    return jnp.where(counts, time, 1.0)


def _impact(
    moved: Moved, near: Near, moment: jax.Array, first: jax.Array
) -> tuple[Moved, jax.Array]:
    """One impact of each part, and the rest of its step; and whether it touched the ground then."""
    share = (moment - moved.done) / (1.0 - moved.done)
    place, turn = moved.sweep.part_way(share)
    manifold = near.touch(pose(place, turn))
    touched = (manifold.touching & first).any(0)
    # Box2D solves the contact that it found first before the part's others.
    manifold = manifolds.forward(manifold, first)
    contacts = manifolds.remember(moved.contacts, manifold)
    feet = manifolds.feet_after(moved.feet, moved.contacts, contacts)

    def lift(carry: tuple) -> tuple:
        count, place, turn, active = carry
        new_place, new_turn, least = contact_solver.position_round(
            place, turn, manifold, contact_solver.WEIGHT, _FIRMNESS
        )
        place, turn = where(active, new_place, place), jnp.where(active, new_turn, turn)
        return count + 1, place, turn, active & (least < _GOOD_ENOUGH)

    def sinks(carry: tuple) -> jax.Array:
        return carry[3].any() & (carry[0] < _POSITION_ROUNDS)

    _, place, turn, _ = jax.lax.while_loop(sinks, lift, (0, place, turn, touched))
    grip = contact_solver.prepare(manifold, pose(place, turn))
    zero = jnp.zeros_like(contacts.normal[0])

    def round_(carry: tuple) -> tuple:
        count, old, normal, along, active = carry
        new, *impulses = contact_solver.velocity_round(old, grip, normal, along)
        new, normal, along = jax.tree.map(
            lambda after, before: jnp.where(active, after, before),
            (new, *impulses),
            (old, normal, along),
        )
        gaps = jax.tree.map(lambda after, before: jnp.abs(after - before), new, old)
        changed = jnp.stack(jax.tree.leaves(gaps)).max(0) > _STILL
        return count + 1, new, normal, along, active & changed

    def changes(carry: tuple) -> jax.Array:
        return (carry[0] < constants.VELOCITY_ROUNDS) & carry[-1].any()

    start = 0, moved.speeds, (zero, zero), (zero, zero), touched
    _, speeds, *_ = jax.lax.while_loop(changes, round_, start)
    rest = (1.0 - moment) * constants.SECONDS
    speeds, end_place, end_turn = glide(speeds, place, turn, rest)
    sweep = Sweep(place, turn, end_place, end_turn)
    return Moved(sweep, moment, speeds, contacts, feet), touched


def glide(
    speeds: Speeds, place: Vec, turn: jax.Array, seconds: jax.Array | float
) -> tuple[Speeds, Vec, jax.Array]:
    """Moves bodies on, no faster than Box2D lets them.

    Args:
        speeds: velocities.
        place: where the bodies are [m].
        turn: their angles [rad].
        seconds: how long [s].

    Returns:
        Velocities, places and angles after it.
    """
    way = speeds.velocity * seconds
    squared = dot(way, way)
    far = squared > constants.MAX_TRANSLATION**2
    slower = constants.MAX_TRANSLATION / jnp.sqrt(jnp.where(far, squared, 1.0))
    velocity = speeds.velocity * jnp.where(far, slower, 1.0)
    turned = jnp.abs(speeds.spin * seconds)
    fast = turned > constants.MAX_ROTATION
    spin = speeds.spin * jnp.where(fast, constants.MAX_ROTATION / jnp.where(fast, turned, 1.0), 1.0)
    return Speeds(velocity, spin), place + velocity * seconds, turn + spin * seconds
