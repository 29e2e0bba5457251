"""What the task learner makes of the steps that the human took, by name.

A step in human hands is a transition as any other: its reward and what came of it are learned from
whoever acted. Beyond that a learner can draw such steps more often, and imitate the human.
"""

import dataclasses
from collections.abc import Mapping
from typing import Protocol

import chex
import jax.numpy as jnp

from hitl_jax.choices.checks import require
from hitl_jax.choices.options import Option, options_of
from hitl_jax.choices.registry import Registry, having
from hitl_jax.types import Transition

WEIGHT = "imitation_weight"
BOUND = "proxy_value"
"""Names of the options, in `Hyper.extra`."""


class HumanData(Protocol):
    """What is made of human steps; an object must be hashable, as a frozen dataclass is.

    Attributes:
        share: of each minibatch, what is sought among the human's steps, 0 to 1. Where too few are
            found, others take their place.
        changes_actor: whether `actor_loss` is asked.
        changes_critic: whether `critic_loss` is asked.
        replaces_reward: whether it stands in the place of the environment's reward, whose weight
            must then be 0.
        options: traced numbers of its own; they are in `hyper.extra`, by name.
    """

    def __hash__(self) -> int: ...

    @property
    def share(self) -> float:
        """See above."""

    @property
    def changes_actor(self) -> bool:
        """See above."""

    @property
    def changes_critic(self) -> bool:
        """See above."""

    @property
    def replaces_reward(self) -> bool:
        """See above."""

    @property
    def options(self) -> tuple[Option, ...]:
        """See above."""

    def actor_loss(
        self, extra: Mapping[str, chex.Array], action: chex.Array, batch: Transition
    ) -> chex.Array:
        """What the actor descends beside its own loss, [].

        Args:
            extra: the run's numbers of the choices' own, by name, each [].
            action: μ(s) of the minibatch, [B, A].
            batch: leading axis B.
        """

    def critic_loss(
        self,
        extra: Mapping[str, chex.Array],
        taken: chex.Array,
        machine: chex.Array,
        batch: Transition,
    ) -> chex.Array:
        """What the critics descend beside their own loss, [].

        Args:
            extra: see `actor_loss`.
            taken: Q_e(s, a) of the actions that were taken, [E, B].
            machine: Q_e(s, μ(s)), [E, B]; the actor is not changed by it.
            batch: leading axis B.
        """


def _require_usable(choice: HumanData) -> None:
    """Checks what a choice says of itself; InvalidValue is one line."""
    require("share", choice.share, 0.0, 1.0)
    options_of(choice)


HUMAN_DATA: Registry[HumanData] = Registry(
    "use of human steps",
    "human_data",
    having(
        *("share", "changes_actor", "changes_critic", "replaces_reward", "options"),
        *("actor_loss", "critic_loss"),
    ),
    require=_require_usable,
)


@dataclasses.dataclass(frozen=True)
class Drawn:
    """Human steps are drawn, at least as often as a share says, and not imitated.

    Attributes:
        share: see `HumanData`.
        changes_actor: it does not.
        changes_critic: it does not.
        replaces_reward: it does not.
        options: none.
    """

    share: float = 0.0
    changes_actor: bool = False
    changes_critic: bool = False
    replaces_reward: bool = False
    options: tuple[Option, ...] = ()

    def actor_loss(
        self, extra: Mapping[str, chex.Array], action: chex.Array, batch: Transition
    ) -> chex.Array:
        """0."""
        del extra, action, batch
        return jnp.zeros((), jnp.float32)

    def critic_loss(
        self,
        extra: Mapping[str, chex.Array],
        taken: chex.Array,
        machine: chex.Array,
        batch: Transition,
    ) -> chex.Array:
        """0."""
        del extra, taken, machine, batch
        return jnp.zeros((), jnp.float32)


@dataclasses.dataclass(frozen=True)
class Imitated(Drawn):
    """The actor is also pulled to what the human did, where the human acted.

    Attributes:
        share: see `HumanData`.
        changes_actor: it does.
        options: the pull.
    """

    changes_actor: bool = True
    options: tuple[Option, ...] = (
        Option(WEIGHT, 10.0, "what a squared distance of 1 from a^h costs", "return", 0.0),
    )

    def actor_loss(
        self, extra: Mapping[str, chex.Array], action: chex.Array, batch: Transition
    ) -> chex.Array:
        """The weight times the mean over the minibatch of |μ(s) - a^h|², 0 at other steps, []."""
        if batch.human is None:
            return jnp.zeros((), jnp.float32)
        chex.assert_equal_shape([action, batch.action])
        distance = jnp.sum(jnp.square(action - batch.action), axis=-1)
        return extra[WEIGHT] * jnp.mean(batch.human * distance)


@dataclasses.dataclass(frozen=True)
class Valued(Drawn):
    """The critics are told what the human's action is worth, and what the machine's is.

    Attributes:
        share: see `HumanData`.
        changes_critic: it does.
        replaces_reward: it does.
        options: the value that is told.
    """

    changes_critic: bool = True
    replaces_reward: bool = True
    options: tuple[Option, ...] = (
        Option(
            BOUND, 1.0, "value that is told of a^h; the machine's is its negative", "return", 0.0
        ),
    )

    def critic_loss(
        self,
        extra: Mapping[str, chex.Array],
        taken: chex.Array,
        machine: chex.Array,
        batch: Transition,
    ) -> chex.Array:
        """The mean over the minibatch of Σ_e (Q_e(s, a^h) - B)² + (Q_e(s, μ(s)) + B)², [].

        0 at steps that the human did not take.
        """
        if batch.human is None:
            return jnp.zeros((), jnp.float32)
        chex.assert_equal_shape([taken, machine])
        bound = extra[BOUND]
        each = jnp.square(taken - bound) + jnp.square(machine + bound)
        return jnp.mean(batch.human * jnp.sum(each, axis=0))


@HUMAN_DATA.register("transitions", "they are transitions as any other")
def transitions() -> HumanData:
    """Nothing is made of them."""
    return Drawn()


@HUMAN_DATA.register("half", "half of each minibatch is sought among them")
def half() -> HumanData:
    """After RLPD (https://arxiv.org/abs/2302.02948) and HIL-SERL (https://arxiv.org/abs/2410.21845).

    There it is half; here what 16 draws for each place find, 1 − (1 − p)^16 of it where a share p
    of the replay is the human's.
    """
    return Drawn(share=0.5)


@HUMAN_DATA.register("imitation", "the actor is pulled to the human's actions")
def imitation() -> HumanData:
    """A behaviour-cloning term beside the value.

    As in https://arxiv.org/abs/1709.10089, without its filter, and in TD3+BC
    (https://arxiv.org/abs/2106.06860), on the human's steps alone and without its scaling of Q: the
    weight is in units of the return.
    """
    return Imitated()


@HUMAN_DATA.register("half-imitation", "both of these")
def half_imitation() -> HumanData:
    """`half` and `imitation`."""
    return Imitated(share=0.5)


@HUMAN_DATA.register("proxy", "the critics are told that the human's actions are worth more")
def proxy() -> HumanData:
    """The proxy values of PVP (https://github.com/metadriverse/pvp), and `half`.

    No reward is learned from: `reward_weight` must be 0, and `feedback` should be. In PVP the
    machine's action is the one that the human overruled. Here it is what the actor would do now:
    where it has come to do what the human does, the two values cancel.
    """
    return Valued(share=0.5)
