"""The solver's rounds with a thread for each part of the legs; not run on a GPU yet.

Few walkers leave most of a GPU idle: a step takes as long as one thread takes for its instructions,
one after the other. Here four threads share a walker's. Each has the contacts of its own part and,
like the others, the hull and both parts of its leg; they tell each other by `jnp.flip` over the
axis of the legs or over that of their parts. What is done to a body is the same as in `world`, in
the same order.

Arrays are [..., 2 legs, 2 for thigh and shin, B]. The legs are alike, but for
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
from hitl_jax.walker.physics.contact_solver import Grips, Pair
from hitl_jax.walker.physics.joints import Hinges, Impulses, Placed
from hitl_jax.walker.physics.manifolds import Manifold

_LANES = (2, 2)
"""Legs, and thigh and shin: the axes of threads, for `as_kernel`."""
_HIP, _KNEE = 0, 1
"""Hinges of the first leg, in the place of the second's."""
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
        hull: its velocities, the same in all threads.
        thigh: of the thread's leg.
        shin: likewise.
        hip: impulses of the leg's upper hinge.
        knee: of the lower one.
        normal: of the part's contacts, of their two points [slots, 2, 2, B].
        along: likewise, of friction.
    """

    hull: Speeds
    thigh: Speeds
    shin: Speeds
    hip: Impulses
    knee: Impulses
    normal: Pair
    along: Pair


def _spread(tree: Tree) -> Tree:
    """Numbers of the legs' parts [..., 4, B], each where its thread is."""
    result: Tree = jax.tree.map(
        lambda leaf: leaf.reshape(*leaf.shape[:-2], *_LANES, leaf.shape[-1]), tree
    )
    return result


def _merged(tree: Tree) -> Tree:
    """Numbers of the legs' parts from their threads, [..., 4, B]."""
    result: Tree = jax.tree.map(
        lambda leaf: leaf.reshape(*leaf.shape[:-3], math.prod(_LANES), leaf.shape[-1]), tree
    )
    return result


def _of_both(tree: Tree, part: int) -> Tree:
    """Those of one part, or of one hinge, of each leg, where both threads of the leg are."""

    def one(leaf: jax.Array) -> jax.Array:
        chosen = leaf[..., part : part + 1, :]
        return jnp.broadcast_to(chosen, (*chosen.shape[:-2], _LANES[1], chosen.shape[-1]))

    result: Tree = jax.tree.map(one, _spread(tree))
    return result


def _of_all(tree: Tree) -> Tree:
    """Those of the hull [..., B], where all threads of the walker are."""

    def one(leaf: jax.Array) -> jax.Array:
        lanes = (*_LANES, leaf.shape[-1])
        return jnp.broadcast_to(leaf[..., None, None, :], (*leaf.shape[:-1], *lanes))

    result: Tree = jax.tree.map(one, tree)
    return result


def _paired(thighs: Tree, shins: Tree) -> Tree:
    """Numbers of thighs and shins, or of hips and knees, that all threads of a leg have."""

    def one(thigh: jax.Array, shin: jax.Array) -> jax.Array:
        return jnp.stack([thigh[..., 0, :], shin[..., 0, :]], axis=-2)

    result: Tree = jax.tree.map(one, thighs, shins)
    return _merged(result)


def _chosen(condition: jax.Array, yes: Tree, no: Tree) -> Tree:
    result: Tree = jax.tree.map(lambda a, b: jnp.where(condition, a, b), yes, no)
    return result


def _of_leg(second: bool, tree: Tree) -> Tree:
    """What one of the legs has, in the threads of both."""
    here = _SECOND_LEG if second else ~_SECOND_LEG
    result: Tree = jax.tree.map(lambda leaf: jnp.where(here, leaf, jnp.flip(leaf, _LEG_AXIS)), tree)
    return result


def _both_parts(own: Tree) -> tuple[Tree, Tree]:
    """What thigh and shin have, from what the thread's own part has."""
    other = jax.tree.map(lambda leaf: jnp.flip(leaf, _PART_AXIS), own)
    return _chosen(_SHIN, other, own), _chosen(_SHIN, own, other)


def velocities(
    speeds: Speeds, impulses: Impulses, pressed: tuple[Pair, Pair], hinge: Hinges, grip: Grips
) -> tuple[Speeds, Impulses, tuple[Pair, Pair]]:
    """Velocities after all rounds.

    Args:
        speeds: of the five bodies [5, B].
        impulses: of the hinges [4, B].
        pressed: impulses of the contacts along normals and of friction, [slots, 4, B].
        hinge: that do not change.
        grip: the contacts.

    Returns:
        The first three after them.
    """
    batch = speeds.spin.shape[-1]
    grip = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (*leaf.shape[:-1], batch)), grip)
    legs = _rows(speeds, slice(1, 5))
    normal, along = _spread(pressed)
    motion = _Motion(
        hull=_of_all(_rows(speeds, 0)),
        thigh=_of_both(legs, 0),
        shin=_of_both(legs, 1),
        hip=_of_both(impulses, _HIP),
        knee=_of_both(impulses, _KNEE),
        normal=normal,
        along=along,
    )
    after = as_kernel(_velocity_rounds, _LANES)(
        motion, _of_both(hinge, _HIP), _of_both(hinge, _KNEE), _spread(grip)
    )
    return (
        _behind(after.hull, _paired(after.thigh, after.shin)),
        _paired(after.hip, after.knee),
        _merged((after.normal, after.along)),
    )


def settled(
    place: Vec, angle: jax.Array, side: jax.Array, manifold: Manifold, firmness: float, sound: float
) -> Placed:
    """Places and angles after the position rounds.

    Args:
        place: of the five bodies [5, B] [m].
        angle: likewise [rad].
        side: of the hinges' limits [4, B].
        manifold: of the contacts [slots, 4, B].
        firmness: see `contact_solver.position_round`.
        sound: contacts that are not deeper are well [m].

    Returns:
        Both after them.
    """
    bodies = place, angle
    hull, own = as_kernel(functools.partial(_position_rounds, firmness, sound), _LANES)(
        _of_all(_rows(bodies, 0)),
        _spread(_rows(bodies, slice(1, 5))),
        _of_both(side, _HIP),
        _of_both(side, _KNEE),
        _spread(manifold),
    )
    return _behind(hull, _merged(own))


def _rows(tree: Tree, rows: int | slice) -> Tree:
    result: Tree = jax.tree.map(lambda leaf: leaf[rows], tree)
    return result


def _behind(hull: Tree, legs: Tree) -> Tree:
    """All bodies [5, B], from the hull's threads and rows of the legs."""
    result: Tree = jax.tree.map(lambda head, rest: jnp.concatenate([head[0, :1], rest]), hull, legs)
    return result


def _velocity_rounds(motion: _Motion, hips: Hinges, knees: Hinges, grip: Grips) -> _Motion:
    """All velocity rounds.

    Box2D's order is: knee and hip of the second leg, hip and knee of the first, contacts. The legs
    meet in the hull alone, so that the second's knee and the contacts of both have no need of the
    first's knee: that, and its contacts, is put off until both knees can be solved at once. So the
    first leg is a part of a round behind the second, and one more is made to end with.
    """
    last = constants.VELOCITY_ROUNDS

    def round_(count: jax.Array, motion: _Motion) -> _Motion:
        begins, goes_on = count < last, count > 0
        due = jnp.where(_SECOND_LEG, begins, goes_on)
        hull, thigh, shin = motion.hull, motion.thigh, motion.shin
        solved = joints.solve(_KNEE, (thigh, shin), knees, motion.knee)
        (thigh, shin), knee = _chosen(due, solved, ((thigh, shin), motion.knee))

        solved = joints.solve(_HIP, (hull, thigh), hips, motion.hip)
        second = begins & _SECOND_LEG
        (hull, thigh), hip = _chosen(second, solved, ((hull, thigh), motion.hip))
        hull = _of_leg(True, hull)

        own = _chosen(_SHIN, shin, thigh)
        before = own, motion.normal, motion.along
        own, normal, along = _chosen(
            due, contact_solver.velocity_round(own, grip, *before[1:]), before
        )
        thigh, shin = _both_parts(own)

        solved = joints.solve(_HIP, (hull, thigh), hips, hip)
        first = begins & ~_SECOND_LEG
        (hull, thigh), hip = _chosen(first, solved, ((hull, thigh), hip))
        hull = _of_leg(False, hull)
        return _Motion(hull, thigh, shin, hip, knee, normal, along)

    return jax.lax.fori_loop(0, last + 1, round_, motion)


def _position_rounds(
    firmness: float,
    sound: float,
    hull: Placed,
    own: Placed,
    hip_side: jax.Array,
    knee_side: jax.Array,
    manifold: Manifold,
) -> tuple[Placed, Placed]:
    """As many position rounds as are needed and allowed; hull and parts after them."""
    like = own[1].shape
    weight = jax.tree.map(
        lambda leaf: jnp.broadcast_to(leaf.reshape(*_LANES, 1), like), contact_solver.WEIGHT
    )
    references = [jnp.broadcast_to(of_legs, like) for of_legs in _REFERENCES]

    def one(carry: tuple) -> tuple:
        count, hull, own, active = carry
        place, turn = own
        place, turn, least = contact_solver.position_round(place, turn, manifold, weight, firmness)
        thigh, shin = _both_parts((place, turn))
        # Box2D's order is: knee and hip of the second leg, hip and knee of the first.
        bent, of_knee = joints.join(_KNEE, (thigh, shin), knee_side, references[_KNEE])
        thigh, shin = _chosen(_SECOND_LEG, bent, (thigh, shin))
        (new_hull, swung), of_hip = joints.join(_HIP, (hull, thigh), hip_side, references[_HIP])
        thigh, well = _chosen(_SECOND_LEG, (swung, of_knee & of_hip), (thigh, of_knee))
        new_hull = _of_leg(True, new_hull)
        (new_hull, swung), of_hip = joints.join(_HIP, (new_hull, thigh), hip_side, references[_HIP])
        new_hull = _of_leg(False, new_hull)
        bent, of_knee = joints.join(_KNEE, (swung, shin), knee_side, references[_KNEE])
        thigh, shin = _chosen(_SECOND_LEG, (thigh, shin), bent)
        well = jnp.where(_SECOND_LEG, well, of_knee & of_hip) & (least >= sound)
        well &= jnp.flip(well, _PART_AXIS)
        well &= jnp.flip(well, _LEG_AXIS)
        after = new_hull, _chosen(_SHIN, shin, thigh)
        hull, own = _chosen(active, after, (hull, own))
        return count + 1, hull, own, active & ~well

    def goes(carry: tuple) -> jax.Array:
        return carry[-1].any() & (carry[0] < constants.POSITION_ROUNDS)

    active = jnp.ones(like, bool)
    _, hull, own, _ = jax.lax.while_loop(goes, one, (0, hull, own, active))
    return hull, own
