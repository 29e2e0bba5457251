"""A danger model that has seen many walkers fall, and knows how it looks before.

People foresee a fall from the pose. This one was fitted to walkers of its own, in training for a
while, and what came of each of their poses (`hitl-jax human`). It looks at one observation, and at
nothing that the learner of a run knows.
"""

import functools
from collections.abc import Callable

import chex
import jax

from hitl_jax.choices.options import Option
from hitl_jax.human import shipped_network
from hitl_jax.human.danger import DANGER_MODELS
from hitl_jax.human.indicator import WALKER_OBSERVATION
from hitl_jax.human.params import HumanParams
from hitl_jax.human.part import HumanPart, memoryless
from hitl_jax.learner.networks import RiskNetwork
from hitl_jax.xla.row_by_row import row_by_row

FILE, PREFIX = "experience.npz", "network"
"""Where its parameters are: of a `RiskNetwork`."""

LEAST = "least_expectation"
"""Name of the option, in `HumanParams.extra`."""


Expectation = Callable[[chex.Array], chex.Array]
"""Maps s_t [O] to the probability of a fall soon, []."""


def expectation(observation: chex.Array) -> chex.Array:
    """The probability of a fall within a second, to one who has seen many walkers fall, [].

    Args:
        observation: s_t, [24].
    """
    return expectation_of(FILE)(observation)


@functools.cache
def expectation_of(file: str, package: str = "hitl_jax.human") -> Expectation:
    """What one expects who has seen what a file's network was fitted to.

    Args:
        file: of a `RiskNetwork`, see `shipped_network.load`.
        package: where it is.
    """
    network, (*hidden, _) = shipped_network.load(file, PREFIX, package)
    logit = functools.partial(row_by_row(RiskNetwork(tuple(hidden)).apply), network)

    def expected(observation: chex.Array) -> chex.Array:
        return jax.nn.sigmoid(logit(observation))

    return expected


@DANGER_MODELS.register(
    "experienced", "to one who has seen many walkers fall, a fall within a second looks likely"
)
def experienced() -> HumanPart:
    """Danger is a fall within a second that is expected with at least `least_expectation`."""
    return expecting(expectation, WALKER_OBSERVATION)


def expecting(expected: Expectation, observation_size: int) -> HumanPart:
    """Danger is what is expected with at least `least_expectation`.

    Args:
        expected: by this human.
        observation_size: O.
    """

    def rule(
        params: HumanParams, observation: chex.Array, dangerous: chex.Array, key: chex.PRNGKey
    ) -> chex.Array:
        del dangerous, key
        return expected(observation) >= params.extra[LEAST]

    least = Option(LEAST, 0.05, "probability from which a fall is expected", "1", 0.0, 1.0)
    return memoryless(rule, observation_size, (least,))
