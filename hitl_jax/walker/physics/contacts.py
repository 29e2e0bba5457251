"""What is remembered of contacts from step to step: impulses for warm starting, ground contact.

Arrays are [slots, parts, B] where not said otherwise; the batch is the last axis.

Source: the behaviour of Box2D 2.3's `b2Contact::Update` and of gymnasium's `ContactDetector`.
"""

import dataclasses

import jax
import jax.numpy as jnp

from hitl_jax.walker.batching.stacked_leaves import map_stacked
from hitl_jax.walker.physics.manifolds import FIRST_BOX, SLOTS, Manifold


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Contacts:
    """The contacts of a step, with the impulses from which the next step starts.

    Attributes:
        edge: number of the edge or box in each slot, int32; -1 for none.
        keys: of the two points, see `Manifold.keys`.
        valid: which of the two points exist.
        normal: impulses along the normal, of the two points [N s].
        friction: impulses along the tangent, of the two points [N s].
    """

    edge: jax.Array
    keys: tuple[jax.Array, jax.Array]
    valid: tuple[jax.Array, jax.Array]
    normal: tuple[jax.Array, jax.Array]
    friction: tuple[jax.Array, jax.Array]

    @property
    def touching(self) -> jax.Array:
        """Whether there is a point."""
        return self.valid[0] | self.valid[1]


def no_contacts(batch: int) -> Contacts:
    """The contacts of walkers in the air, [4, 4, B].

    Args:
        batch: B.
    """
    none = jnp.zeros((4, 4, batch), jnp.int32)
    no = jnp.zeros((4, 4, batch), bool)
    zero = jnp.zeros((4, 4, batch), jnp.float32)
    return Contacts(none - 1, (none, none), (no, no), (zero, zero), (zero, zero))


def match_impulses(old: Contacts, manifold: Manifold) -> Contacts:
    """The contacts of new manifolds; a point that was there before keeps its impulses.

    Args:
        old: contacts before.
        manifold: of the slots now.

    Returns:
        The contacts now; impulses of new points are 0.
    """
    before = _by_edge(old, manifold.edge)

    def matched(key: jax.Array, values: tuple[jax.Array, jax.Array]) -> jax.Array:
        is_first, is_second = (
            valid & (old_key == key)
            for valid, old_key in zip(before.valid, before.keys, strict=True)
        )
        return jnp.where(is_first, values[0], jnp.where(is_second, values[1], 0.0))

    one, two = manifold.keys
    return Contacts(
        manifold.edge,
        manifold.keys,
        manifold.valid,
        (matched(one, before.normal), matched(two, before.normal)),
        (matched(one, before.friction), matched(two, before.friction)),
    )


def _by_edge(contacts: Contacts, index: jax.Array) -> Contacts:
    """Contacts moved to the slots of given edges; an edge without a contact gets no point."""

    def found(leaves: jax.Array) -> jax.Array:
        result = jnp.zeros_like(leaves)
        for slot in range(SLOTS):
            result = jnp.where(contacts.edge[slot] == index, leaves[:, slot, None], result)
        return result

    return dataclasses.replace(map_stacked(found, contacts), edge=index)


def ground_contact_after(ground_contact: jax.Array, old: Contacts, new: Contacts) -> jax.Array:
    """Gymnasium's `ground_contact` of each part after a step.

    Gymnasium sets the flag when a contact begins and clears it when one ends, even while another
    goes on. Where several begin or end in one step, the last event decides: that of the leftmost.

    Args:
        ground_contact: before, bool [parts, B].
        old: contacts before.
        new: contacts now.

    Returns:
        The flags now, bool [parts, B].
    """
    begins = new.touching & ~_by_edge(old, new.edge).touching
    ends = old.touching & ~_by_edge(new, old.edge).touching
    far = jnp.int32(FIRST_BOX)
    begun = jnp.where(begins, new.edge % FIRST_BOX, far).min(0)
    ended = jnp.where(ends, old.edge % FIRST_BOX, far).min(0)
    last = jnp.minimum(begun, ended)
    return jnp.where(last == far, ground_contact, begun <= ended)
