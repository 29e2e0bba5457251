"""How the hands that come with the package are made: a walker that goes on where others stumble.

A crew of mediocre walkers is trained first. Then new walkers learn to walk while members of the
crew take the controls now and then, and give them back where a stumble shows, or at some time
before. What a member does is in the replay, so that a walker learns from it, and what it learns is
to recover. Of several, the one whose tests with the crew have the greatest return becomes the hands
(`human.trained_walker`).
"""

import io
from collections.abc import Callable, Sequence

import chex
import jax
import jax.numpy as jnp
import numpy as np

from hitl_jax.config import AgentConfig, Hyper, Method, hyper_for
from hitl_jax.human.actions import ActionSource
from hitl_jax.human.foresight import overreach
from hitl_jax.human.indicator import WALKER_OBSERVATION, hull_angle
from hitl_jax.human.params import HumanParams
from hitl_jax.human.part import HumanPart, unmoved
from hitl_jax.learner.networks import Actor
from hitl_jax.sweep.train_and_test import Batch, Tested, Walkers, train_and_test
from hitl_jax.team.agent import Agent, make_agent
from hitl_jax.training.rollout import Rollout
from hitl_jax.training.run_spec import LoopConfig, RunSpec
from hitl_jax.types import Params

CREW_SEEDS, HANDS_SEEDS = range(100, 110), range(120, 124)
"""None of those that a sweep reports."""

_SNAPSHOTS = 4
"""Of each member's training; each is one of the crew."""

_RELIEF = 0.02
"""Probability a step that another member stands ready."""

_BEGINS, _GIVES_BACK = 0.012, 0.008
"""Probability a step that a member takes the controls, and that it gives them back unstumbled."""

_OVERREACH = (2.0, 3.6)
"""Least and greatest overreach at which a member gives back [m]; drawn anew for each takeover."""

_TILT, _TILT_SPAN = 0.25, 0.16
"""Least tilt at which a member gives back, and by how much that grows with the overreach [rad]."""

_HYPER = Hyper(
    boundary_low=0.0,
    initial_boundary=0.0,  # An alarm at every step.
    feedback=0.0,
    takeover_steps=1,
)

Watch = Callable[[Rollout], None]


def train_crew(episodes: int, test_episodes: int, watch: Watch) -> list[Tested]:
    """Trains the walkers that stumble.

    Args:
        episodes: training episodes of each.
        test_episodes: of each.
        watch: see `train_and_test`.
    """
    points = tuple(episodes * part // _SNAPSHOTS for part in range(1, _SNAPSHOTS + 1))
    hyper = hyper_for(Method.SRL, Hyper())
    specs = [RunSpec(Method.SRL, seed, hyper, episodes, points) for seed in CREW_SEEDS]
    agent = make_agent(AgentConfig(learner="ddpg"))
    return _trained("crew", agent, specs, test_episodes, watch)


def train_hands(
    crew: Sequence[Tested], episodes: int, test_episodes: int, watch: Watch
) -> list[Tested]:
    """Trains walkers that are given the controls by a crew.

    Args:
        crew: of `train_crew`.
        episodes: training episodes of each.
        test_episodes: of each, alone and with the crew.
        watch: see `train_and_test`.
    """
    policies = [kept.behavior.actor for one in crew for kept in one.finished.run.snapshots]
    config = AgentConfig(intervention="takeover")
    agent = make_agent(config, judge=relay(), source=crew_actions(policies))
    hyper = hyper_for(Method.HITL_FIX, _HYPER)
    specs = [RunSpec(Method.HITL_FIX, seed, hyper, episodes) for seed in HANDS_SEEDS]
    return _trained("hands", agent, specs, test_episodes, watch)


def _trained(
    name: str, agent: Agent, specs: Sequence[RunSpec], test_episodes: int, watch: Watch
) -> list[Tested]:
    walkers = Walkers("lean", len(specs), None, test_episodes)
    return list(train_and_test(Batch(name, agent, specs, LoopConfig(), walkers), watch))


def mean_return(one: Tested, mode: str) -> float:
    """Mean return of a run's tests alone (`autonomous`), or with the crew (`assisted`)."""
    return float(np.mean([row["return"] for row in one.tests if row["mode"] == mode]))


def best_hands(hands: Sequence[Tested]) -> Tested:
    """Those whose tests with the crew have the greatest return."""
    return max(hands, key=lambda one: mean_return(one, "assisted"))


def to_npz(hands: Tested) -> bytes:
    """The actor as a file like a run's params.npz."""
    layers = hands.finished.train.learner.actor["params"]
    arrays = {
        f"actor/params/{layer}/{part}": np.asarray(array)
        for layer, parts in layers.items()
        for part, array in parts.items()
    }
    data = io.BytesIO()
    np.savez(data, **arrays)  # type: ignore[arg-type]
    return data.getvalue()


def relay() -> HumanPart:
    """Who judges for a crew: dangerous, and so in its hands, from a random step to a stumble."""

    def judge(
        state: tuple[chex.Array, chex.Array],
        params: HumanParams,
        observation: chex.Array,
        dangerous: chex.Array,
        key: chex.PRNGKey,
    ) -> tuple[tuple[chex.Array, chex.Array], chex.Array]:
        del params, dangerous
        holds, limit = state
        least, most = _OVERREACH
        keys = jax.random.split(key, 3)
        tilt = _TILT + _TILT_SPAN * (limit - least) / (most - least)
        stumbles = (overreach(observation) >= limit) | (jnp.abs(hull_angle(observation)) >= tilt)
        gives_back = stumbles | (jax.random.uniform(keys[0]) < _GIVES_BACK)
        begins = (jax.random.uniform(keys[1]) < _BEGINS) & ~stumbles
        fresh = jax.random.uniform(keys[2], minval=least, maxval=most)
        after = jnp.where(holds, ~gives_back, begins)
        return (after, jnp.where(holds, limit, fresh)), after

    return HumanPart(
        init=lambda: (jnp.zeros((), bool), jnp.full((), _OVERREACH[0], jnp.float32)),
        begin_episode=lambda state: (jnp.ones((), bool), state[1]),
        judge=judge,
        notify=unmoved,
        observation_size=WALKER_OBSERVATION,
    )


def crew_actions(policies: Sequence[Params]) -> ActionSource:
    """Actions of a crew, one member after another at random.

    Args:
        policies: parameters of an `Actor`, of equal widths.
    """
    every = jax.tree.map(lambda *leaves: np.stack(leaves), *policies)
    *hidden, action_size = (
        len(policies[0]["params"][f"Dense_{place}"]["bias"])
        for place in range(len(policies[0]["params"]))
    )
    actor = Actor(tuple(hidden), action_size)

    def act(
        member: chex.Array, observation: chex.Array, key: chex.PRNGKey
    ) -> tuple[chex.Array, chex.Array]:
        keys = jax.random.split(key)
        other = jax.random.randint(keys[1], (), 0, len(policies))
        member = jnp.where(jax.random.uniform(keys[0]) < _RELIEF, other, member)
        own = jax.tree.map(lambda leaf: jnp.asarray(leaf)[member], every)
        return member, actor.apply(own, observation)

    return ActionSource(
        init=lambda: jnp.zeros((), jnp.int32),
        begin_episode=lambda member: member,
        act=act,
        observation_size=WALKER_OBSERVATION,
        action_size=action_size,
    )
