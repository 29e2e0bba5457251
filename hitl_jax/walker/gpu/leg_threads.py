"""The solver's iterations for a GPU, with one thread for each part of the legs.

With few walkers most of a GPU is idle, and a step takes as long as one thread takes for its
instructions. Here four threads share the instructions of a walker. Each thread has the contacts of
its own part, and copies of the hull and of both parts of its leg; `jnp.flip` over the axis of the
legs, or of their parts, exchanges numbers between threads. Each body gets the same operations as in
`world`, in the same order.

Arrays are [..., 2 legs, 2 for thigh and shin, B]. The two legs' constants are equal, except for
`constants.REFERENCE`.
"""

import dataclasses
import functools
import math
from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from hitl_jax.walker import constants
from hitl_jax.walker.geometry import Speeds, Vec
from hitl_jax.walker.gpu.kernel import as_kernel
from hitl_jax.walker.physics import contact_solver, joints
from hitl_jax.walker.physics.contact_solver import ContactConstraints, Pair
from hitl_jax.walker.physics.joints import BodyPosition, JointConstraints, JointImpulses
from hitl_jax.walker.physics.manifolds import Manifold

_LANES = (2, 2)
"""Legs, and thigh and shin: the axes of threads, for `as_kernel`."""
_HIP, _KNEE = 0, 1
"""JointConstraints of the first leg, in the place of the second's."""
_LEG_AXIS, _PART_AXIS = -3, -2
_SECOND_LEG = jnp.asarray(np.array([False, True]).reshape(2, 1, 1))
_SHIN = jnp.asarray(np.array([False, True]).reshape(2, 1))
_REFERENCES = jnp.asarray(constants.REFERENCE.reshape(2, 2).T[..., None, None], jnp.float32)
"""Of hip and knee [2, 2 legs, 1, 1]."""

Tree = TypeVar("Tree")


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class _Motion:
    """Velocities and impulses within a step.

    Attributes:
        hull: velocities of the hull, the same in all threads.
        thigh: velocities of the thigh of the thread's leg.
        shin: velocities of the shin of the thread's leg.
        hip: impulses of the leg's upper joint.
        knee: impulses of the leg's lower joint.
        normal: normal impulses of the part's contacts, of their two points [slots, 2, 2, B].
        friction: friction impulses of the same points.
    """

    hull: Speeds
    thigh: Speeds
    shin: Speeds
    hip: JointImpulses
    knee: JointImpulses
    normal: Pair
    friction: Pair


def _spread(tree: Tree) -> Tree:
    """Numbers of the legs' parts [..., 4, B], each given to its thread [..., 2, 2, B]."""
    result: Tree = jax.tree.map(
        lambda leaf: leaf.reshape(*leaf.shape[:-2], *_LANES, leaf.shape[-1]), tree
    )
    return result


def _merged(tree: Tree) -> Tree:
    """Numbers of the legs' parts [..., 4, B], from their threads."""
    result: Tree = jax.tree.map(
        lambda leaf: leaf.reshape(*leaf.shape[:-3], math.prod(_LANES), leaf.shape[-1]), tree
    )
    return result


def _of_both(tree: Tree, part: int) -> Tree:
    """Numbers of one part, or one joint, of each leg, given to both threads of the leg."""

    def one(leaf: jax.Array) -> jax.Array:
        chosen = leaf[..., part : part + 1, :]
        return jnp.broadcast_to(chosen, (*chosen.shape[:-2], _LANES[1], chosen.shape[-1]))

    result: Tree = jax.tree.map(one, _spread(tree))
    return result


def _of_all(tree: Tree) -> Tree:
    """Numbers of the hull [..., B], given to all threads of the walker."""

    def one(leaf: jax.Array) -> jax.Array:
        lanes = (*_LANES, leaf.shape[-1])
        return jnp.broadcast_to(leaf[..., None, None, :], (*leaf.shape[:-1], *lanes))

    result: Tree = jax.tree.map(one, tree)
    return result


def _paired(thighs: Tree, shins: Tree) -> Tree:
    """Rows [..., 4, B] of thighs and shins, or hips and knees, which both threads of a leg have."""

    def one(thigh: jax.Array, shin: jax.Array) -> jax.Array:
        return jnp.stack([thigh[..., 0, :], shin[..., 0, :]], axis=-2)

    result: Tree = jax.tree.map(one, thighs, shins)
    return _merged(result)


def _chosen(condition: jax.Array, yes: Tree, no: Tree) -> Tree:
    result: Tree = jax.tree.map(lambda a, b: jnp.where(condition, a, b), yes, no)
    return result


def _of_leg(second: bool, tree: Tree) -> Tree:
    """The numbers of one leg's threads, given to the threads of both legs."""
    here = _SECOND_LEG if second else ~_SECOND_LEG
    result: Tree = jax.tree.map(lambda leaf: jnp.where(here, leaf, jnp.flip(leaf, _LEG_AXIS)), tree)
    return result


def _both_parts(own: Tree) -> tuple[Tree, Tree]:
    """The numbers of thigh and shin, in both threads, from those of the thread's own part."""
    other = jax.tree.map(lambda leaf: jnp.flip(leaf, _PART_AXIS), own)
    return _chosen(_SHIN, other, own), _chosen(_SHIN, own, other)


def velocities(
    speeds: Speeds,
    impulses: JointImpulses,
    contact_impulses: tuple[Pair, Pair],
    joint: JointConstraints,
    constraints: ContactConstraints,
) -> tuple[Speeds, JointImpulses, tuple[Pair, Pair]]:
    """The velocities after all velocity iterations.

    Args:
        speeds: of the five bodies [5, B].
        impulses: of the joints [4, B].
        contact_impulses: normal and friction impulses of the contacts [slots, 4, B].
        joint: constraints of the joints.
        constraints: of the contacts.

    Returns:
        Velocities, joints' impulses and contacts' impulses after the iterations.
    """
    batch = speeds.spin.shape[-1]
    constraints = jax.tree.map(
        lambda leaf: jnp.broadcast_to(leaf, (*leaf.shape[:-1], batch)), constraints
    )
    legs = _rows(speeds, slice(1, 5))
    normal, friction = _spread(contact_impulses)
    motion = _Motion(
        hull=_of_all(_rows(speeds, 0)),
        thigh=_of_both(legs, 0),
        shin=_of_both(legs, 1),
        hip=_of_both(impulses, _HIP),
        knee=_of_both(impulses, _KNEE),
        normal=normal,
        friction=friction,
    )
    after = as_kernel(_velocity_iterations, _LANES)(
        motion, _of_both(joint, _HIP), _of_both(joint, _KNEE), _spread(constraints)
    )
    return (
        _all_bodies(after.hull, _paired(after.thigh, after.shin)),
        _paired(after.hip, after.knee),
        _merged((after.normal, after.friction)),
    )


def positions(
    place: Vec,
    angle: jax.Array,
    side: jax.Array,
    manifold: Manifold,
    baumgarte: float,
    least_separation: float,
) -> BodyPosition:
    """Places and angles after the position iterations.

    Args:
        place: of the five bodies [5, B] [m].
        angle: of the five bodies [5, B] [rad].
        side: of the joints' limits [4, B].
        manifold: of the contacts [slots, 4, B].
        baumgarte: see `contact_solver.position_iteration`.
        least_separation: iterations end when no contact is deeper [m].

    Returns:
        Places and angles after the iterations.
    """
    bodies = place, angle
    hull, own = as_kernel(
        functools.partial(_position_iterations, baumgarte, least_separation), _LANES
    )(
        _of_all(_rows(bodies, 0)),
        _spread(_rows(bodies, slice(1, 5))),
        _of_both(side, _HIP),
        _of_both(side, _KNEE),
        _spread(manifold),
    )
    return _all_bodies(hull, _merged(own))


def _rows(tree: Tree, rows: int | slice) -> Tree:
    result: Tree = jax.tree.map(lambda leaf: leaf[rows], tree)
    return result


def _all_bodies(hull: Tree, legs: Tree) -> Tree:
    """Rows of all bodies [5, B], from the hull's copies and rows of the legs [4, B]."""
    result: Tree = jax.tree.map(lambda head, rest: jnp.concatenate([head[0, :1], rest]), hull, legs)
    return result


def _velocity_iterations(
    motion: _Motion,
    hips: JointConstraints,
    knees: JointConstraints,
    constraints: ContactConstraints,
) -> _Motion:
    """All velocity iterations.

    Box2D's order is: knee and hip of the second leg, hip and knee of the first leg, contacts. The
    legs share the hull alone, so the first leg's knee and contacts can wait until the second leg's
    knee of the next iteration, and both knees are solved at once. The first leg is thus part of an
    iteration behind, and one iteration is added at the end.
    """
    last = constants.VELOCITY_ITERATIONS

    def iteration(count: jax.Array, motion: _Motion) -> _Motion:
        begins, goes_on = count < last, count > 0
        due = jnp.where(_SECOND_LEG, begins, goes_on)
        hull, thigh, shin = motion.hull, motion.thigh, motion.shin
        solved = joints.solve_velocities(_KNEE, (thigh, shin), knees, motion.knee)
        (thigh, shin), knee = _chosen(due, solved, ((thigh, shin), motion.knee))

        solved = joints.solve_velocities(_HIP, (hull, thigh), hips, motion.hip)
        second = begins & _SECOND_LEG
        (hull, thigh), hip = _chosen(second, solved, ((hull, thigh), motion.hip))
        hull = _of_leg(True, hull)

        own = _chosen(_SHIN, shin, thigh)
        before = own, motion.normal, motion.friction
        own, normal, friction = _chosen(
            due, contact_solver.velocity_iteration(own, constraints, *before[1:]), before
        )
        thigh, shin = _both_parts(own)

        solved = joints.solve_velocities(_HIP, (hull, thigh), hips, hip)
        first = begins & ~_SECOND_LEG
        (hull, thigh), hip = _chosen(first, solved, ((hull, thigh), hip))
        hull = _of_leg(False, hull)
        return _Motion(hull, thigh, shin, hip, knee, normal, friction)

    return jax.lax.fori_loop(0, last + 1, iteration, motion)


def _position_iterations(
    baumgarte: float,
    least_separation: float,
    hull: BodyPosition,
    own: BodyPosition,
    hip_side: jax.Array,
    knee_side: jax.Array,
    manifold: Manifold,
) -> tuple[BodyPosition, BodyPosition]:
    """Position iterations while one is needed and allowed; the hull and the parts after them."""
    like = own[1].shape
    inverse_masses = jax.tree.map(
        lambda leaf: jnp.broadcast_to(leaf.reshape(*_LANES, 1), like),
        contact_solver.LEG_INVERSE_MASSES,
    )
    references = [jnp.broadcast_to(of_legs, like) for of_legs in _REFERENCES]

    def one(carry: tuple) -> tuple:
        count, hull, own, active = carry
        place, turn = own
        place, turn, least = contact_solver.position_iteration(
            place, turn, manifold, inverse_masses, baumgarte
        )
        thigh, shin = _both_parts((place, turn))
        # Box2D's order is: knee and hip of the second leg, hip and knee of the first.
        bent, of_knee = joints.solve_positions(_KNEE, (thigh, shin), knee_side, references[_KNEE])
        thigh, shin = _chosen(_SECOND_LEG, bent, (thigh, shin))
        (new_hull, swung), of_hip = joints.solve_positions(
            _HIP, (hull, thigh), hip_side, references[_HIP]
        )
        thigh, done = _chosen(_SECOND_LEG, (swung, of_knee & of_hip), (thigh, of_knee))
        new_hull = _of_leg(True, new_hull)
        (new_hull, swung), of_hip = joints.solve_positions(
            _HIP, (new_hull, thigh), hip_side, references[_HIP]
        )
        new_hull = _of_leg(False, new_hull)
        bent, of_knee = joints.solve_positions(_KNEE, (swung, shin), knee_side, references[_KNEE])
        thigh, shin = _chosen(_SECOND_LEG, (thigh, shin), bent)
        done = jnp.where(_SECOND_LEG, done, of_knee & of_hip) & (least >= least_separation)
        done &= jnp.flip(done, _PART_AXIS)
        done &= jnp.flip(done, _LEG_AXIS)
        after = new_hull, _chosen(_SHIN, shin, thigh)
        hull, own = _chosen(active, after, (hull, own))
        return count + 1, hull, own, active & ~done

    def goes(carry: tuple) -> jax.Array:
        return carry[-1].any() & (carry[0] < constants.POSITION_ITERATIONS)

    active = jnp.ones(like, bool)
    _, hull, own, _ = jax.lax.while_loop(goes, one, (0, hull, own, active))
    return hull, own
