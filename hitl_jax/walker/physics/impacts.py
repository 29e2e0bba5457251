"""Continuous collision: moves parts that would pass through the ground in a step to their impact.

After an impact a part makes the rest of the step alone, without its joints, as in Box2D; the next
step corrects the joints' errors. Arrays are [slots, parts, B] where not said
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
from hitl_jax.walker.physics import contact_solver
from hitl_jax.walker.physics.boxes import NearbyGround
from hitl_jax.walker.physics.contacts import Contacts, ground_contact_after, match_impulses
from hitl_jax.walker.physics.manifolds import touching_first
from hitl_jax.walker.physics.time_of_impact import Sweep, time_of_impact

_MAX_IMPACTS = 8
"""Of one contact in a step (`b2_maxSubSteps`)."""
_BAUMGARTE, _POSITION_ITERATIONS, _LEAST_SEPARATION = 0.75, 20, -1.5 * constants.LINEAR_SLOP
_CONVERGED = 1e-6
"""Iterations end when one changes no velocity by more [m/s, rad/s]: a part alone with the ground
needs few of its 180."""
_STEP_END = 1.0 - 10 * float(np.finfo(np.float32).eps)
"""An impact at this share of the step or later is none."""


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class LegMotion:
    """The motion of the legs' parts in what is left of a step.

    Attributes:
        sweep: from where the parts are at time `done` to where the step would take them.
        done: time of the step that is past, a share of the whole step [parts, B].
        speeds: velocities of the parts.
        contacts: of the parts with the ground.
        ground_contact: gymnasium's flag of each part, bool [parts, B].
    """

    sweep: Sweep
    done: jax.Array
    speeds: Speeds
    contacts: Contacts
    ground_contact: jax.Array


def solve_impacts(moved: LegMotion, near: NearbyGround) -> LegMotion:
    """Stops parts at their impacts with the ground, one impact after the other.

    Args:
        moved: the parts' motion through the whole step, without impacts.
        near: edges and boxes near where the parts would end.

    Returns:
        The parts' motion with `sweep` ending at the end of the step.
    """

    def goes(carry: tuple) -> jax.Array:
        more: jax.Array = carry[-1]
        return more

    def one(carry: tuple) -> tuple:
        moved, count, disabled, _ = carry
        times = _impact_times(moved, near, count, disabled)
        moment = times.min(0)
        has_impact = moment < _STEP_END
        first = has_impact & (times == moment) & (count <= _MAX_IMPACTS)
        after, touched = _impact(moved, near, moment, first)
        lands = has_impact & touched
        moved = jax.tree.map(lambda new, old: jnp.where(lands, new, old), after, moved)
        return moved, count + first, disabled | (first & ~touched), has_impact.any()

    count, disabled = jnp.zeros_like(near.index), jnp.zeros_like(near.index, bool)
    moved, *_ = jax.lax.while_loop(goes, one, (moved, count, disabled, jnp.bool_(True)))
    return moved


def _impact_times(
    moved: LegMotion, near: NearbyGround, count: jax.Array, disabled: jax.Array
) -> jax.Array:
    """The time of each contact's next impact, as a share of the whole step; 1 for none."""
    beta = time_of_impact(moved.sweep, near)
    time = jnp.minimum(moved.done + (1.0 - moved.done) * beta, 1.0)
    counts = (beta < 1.0) & ~disabled & (count <= _MAX_IMPACTS)
    return jnp.where(counts, time, 1.0)


def _impact(
    moved: LegMotion, near: NearbyGround, moment: jax.Array, first: jax.Array
) -> tuple[LegMotion, jax.Array]:
    """Moves each part to its impact, solves it there, and moves the part on to the end of the step.

    Args:
        moved: the parts' motion before the impact.
        near: edges and boxes.
        moment: time of each part's impact, a share of the whole step [parts, B].
        first: the contacts of the impact, bool [slots, parts, B].

    Returns:
        The motion after the impact, and whether the part touches the ground at its time.
    """
    share = (moment - moved.done) / (1.0 - moved.done)
    place, turn = moved.sweep.interpolated(share)
    manifold = near.manifolds(pose(place, turn))
    touched = (manifold.touching & first).any(0)
    # Box2D solves the contact that it found first before the part's others.
    manifold = touching_first(manifold, first)
    contacts = match_impulses(moved.contacts, manifold)
    ground_contact = ground_contact_after(moved.ground_contact, moved.contacts, contacts)

    def push_out(carry: tuple) -> tuple:
        count, place, turn, active = carry
        new_place, new_turn, least = contact_solver.position_iteration(
            place, turn, manifold, contact_solver.LEG_INVERSE_MASSES, _BAUMGARTE
        )
        place, turn = where(active, new_place, place), jnp.where(active, new_turn, turn)
        return count + 1, place, turn, active & (least < _LEAST_SEPARATION)

    def is_deep(carry: tuple) -> jax.Array:
        return carry[3].any() & (carry[0] < _POSITION_ITERATIONS)

    _, place, turn, _ = jax.lax.while_loop(is_deep, push_out, (0, place, turn, touched))
    constraints = contact_solver.prepare(manifold, pose(place, turn))
    zero = jnp.zeros_like(contacts.normal[0])

    def iteration(carry: tuple) -> tuple:
        count, old, normal, friction, active = carry
        new, *impulses = contact_solver.velocity_iteration(old, constraints, normal, friction)
        new, normal, friction = jax.tree.map(
            lambda after, before: jnp.where(active, after, before),
            (new, *impulses),
            (old, normal, friction),
        )
        changes_by = jax.tree.map(lambda after, before: jnp.abs(after - before), new, old)
        changed = jnp.stack(jax.tree.leaves(changes_by)).max(0) > _CONVERGED
        return count + 1, new, normal, friction, active & changed

    def changes(carry: tuple) -> jax.Array:
        return (carry[0] < constants.VELOCITY_ITERATIONS) & carry[-1].any()

    start = 0, moved.speeds, (zero, zero), (zero, zero), touched
    _, speeds, *_ = jax.lax.while_loop(changes, iteration, start)
    rest = (1.0 - moment) * constants.SECONDS
    speeds, end_place, end_turn = integrate_positions(speeds, place, turn, rest)
    sweep = Sweep(place, turn, end_place, end_turn)
    return LegMotion(sweep, moment, speeds, contacts, ground_contact), touched


def integrate_positions(
    speeds: Speeds, place: Vec, turn: jax.Array, seconds: jax.Array | float
) -> tuple[Speeds, Vec, jax.Array]:
    """Moves bodies by their velocities, limited to Box2D's largest translation and rotation.

    Args:
        speeds: velocities.
        place: centres of mass of the bodies [m].
        turn: their angles [rad].
        seconds: time to move for [s].

    Returns:
        The limited velocities, and places and angles after the time.
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
