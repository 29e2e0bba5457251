"""How the trained humans that come with the package are made: what they expect, and their hands.

Of any task (`hitl_jax.tasks`). A crew of mediocre walkers, of two kinds of learner, is trained
first. What came of the poses of its members is what the human has seen (`human.experience`). Then
new walkers learn to walk while members of the crew take the controls now and then, and give them
back where the human expects a fall, or at some time before. What a member does is in the replay,
so that a walker learns from it, and what it learns is to recover. Of several, the one whose tests
with the crew have the greatest return becomes the hands (`human.trained_walker`).
"""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import chex
import jax
import jax.numpy as jnp
import numpy as np
import optax

from hitl_jax.analysis.early_warnings import steps_to_fall
from hitl_jax.config import AgentConfig, Hyper, Method, hyper_for
from hitl_jax.envs import host_backend, make_pool
from hitl_jax.evaluation.host import HostExaminer, play_trial
from hitl_jax.evaluation.trials import Trial
from hitl_jax.human.actions import ActionSource, still
from hitl_jax.human.params import HumanParams
from hitl_jax.human.part import HumanPart, memoryless, unmoved
from hitl_jax.learner import adam
from hitl_jax.learner.networks import Actor, RiskNetwork
from hitl_jax.sweep.changes import Changes, of_task
from hitl_jax.sweep.presets import PAPER
from hitl_jax.sweep.train_and_test import Batch, Tested, Walkers, train_and_test
from hitl_jax.tasks import task_of
from hitl_jax.team.agent import Agent, make_agent
from hitl_jax.training.rollout import Rollout
from hitl_jax.training.run_spec import LoopConfig, RunSpec
from hitl_jax.types import Params
from hitl_jax.xla.row_by_row import row_by_row

CREW = {"ddpg": (range(1000, 1008), 1.0), "td3-tqc": (range(1008, 1012), 0.5)}
"""Of the crew, by task learner: seeds, many, so that the hands meet many gaits; and for what share
of the crew's episodes each is trained: then members of both kinds walk, but still fall."""

HANDS_SEEDS = range(1020, 1023)
"""None of these seeds is one that a sweep reports or is tuned on."""

_SNAPSHOTS = 8
"""Of each member's training: what the human has seen."""

_RELAYING = slice(2, None)
"""Of the snapshots, those whose stumbles a walker can learn from: before, they hardly walk."""

_RELIEF = 0.02
"""Probability a step that another member stands ready."""

_BEGINS, _GIVES_BACK = 0.012, 0.008
"""Probability a step that a member takes the controls, and that it gives them back unstumbled."""

_EXPECTATION = (0.02, 0.8)
"""Least and greatest probability of a fall at which a member gives back; drawn anew, its logarithm
evenly, while none holds."""

EXPERIENCE_SIZES = (64, 64)
"""Hidden layers of what the human expects."""

_BATCH, _LEARNING_RATE, _UPDATES = 512, 1e-3, 20_000

_ALL: Changes = PAPER | {"learner": "td3-tqc"}
"""Named, so that the human does not depend on the defaults."""

Watch = Callable[[Rollout], None]


class Base(NamedTuple):
    """What all walkers of a task's human are trained with.

    Attributes:
        env: the task, see `hitl_jax.tasks.task_of`.
        agent: static choices.
        hyper: the numbers.
    """

    env: str
    agent: AgentConfig
    hyper: Hyper

    def team(
        self, judge: HumanPart | None = None, source: ActionSource | None = None, **changes: Any
    ) -> Agent:
        """A team in which nobody judges, and hands are still, unless somebody is given."""
        config = dataclasses.replace(self.agent, **changes)
        return make_agent(
            config, judge=judge or _nobody(), source=source or still(config.action_size)
        )


def _nobody() -> HumanPart:
    return memoryless(lambda params, observation, dangerous, key: jnp.zeros((), bool))


def base_of(env: str) -> Base:
    """What all walkers of a task's human are trained with.

    Raises:
        ValueError: one line, if the task cannot be had.
    """
    parts = of_task(env, _ALL)
    return Base(env, parts.agent, parts.hyper)


def train_crew(base: Base, episodes: int, test_episodes: int, watch: Watch) -> list[Tested]:
    """Trains the walkers that stumble.

    Args:
        base: of `base_of`.
        episodes: training episodes of each of `ddpg`; of `td3-tqc` half as many.
        test_episodes: of each.
        watch: see `train_and_test`.

    Returns:
        Ended runs, each with a snapshot at every eighth of its training.
    """
    hyper = hyper_for(Method.SRL, base.hyper)
    crew: list[Tested] = []
    for learner, (seeds, share) in CREW.items():
        last = int(episodes * share)
        points = tuple(last * part // _SNAPSHOTS for part in range(1, _SNAPSHOTS + 1))
        specs = [RunSpec(Method.SRL, seed, hyper, last, points) for seed in seeds]
        agent = base.team(learner=learner)
        crew += _trained(base, f"crew-{learner}", agent, specs, test_episodes, watch)
    return crew


def train_hands(
    base: Base,
    crew: Sequence[Tested],
    expects: Params,
    episodes: int,
    test_episodes: int,
    watch: Watch,
) -> list[Tested]:
    """Trains walkers that are given the controls by a crew.

    Args:
        base: of `base_of`.
        crew: of `train_crew`.
        expects: of `gain_experience`.
        episodes: training episodes of each.
        test_episodes: of each, alone and with the crew.
        watch: see `train_and_test`.

    Returns:
        Ended runs, with rows of their tests alone and with the crew.
    """
    policies = [
        kept.behavior.actor for one in crew for kept in one.finished.run.snapshots[_RELAYING]
    ]
    sizes = base.agent.observation_size, base.agent.action_size
    agent = base.team(
        relay(expects, sizes[0]), crew_actions(policies, *sizes), intervention="takeover"
    )
    hyper = dataclasses.replace(
        base.hyper,
        boundary_low=0.0,
        initial_boundary=0.0,  # An alarm at every step.
        feedback=0.0,
        takeover_steps=1,
    )
    specs = [
        RunSpec(Method.HITL_FIX, seed, hyper_for(Method.HITL_FIX, hyper), episodes)
        for seed in HANDS_SEEDS
    ]
    return _trained(base, "hands", agent, specs, test_episodes, watch)


def _trained(
    base: Base,
    name: str,
    agent: Agent,
    specs: Sequence[RunSpec],
    test_episodes: int,
    watch: Watch,
) -> list[Tested]:
    walkers = Walkers(_backend(base.env), len(specs), None, test_episodes, base.env)
    return list(train_and_test(Batch(name, agent, specs, LoopConfig(), walkers), watch))


def _backend(env: str) -> str:
    return host_backend(task_of(env).env_id)


def gain_experience(
    base: Base, crew: Sequence[Tested], episodes: int, say: Callable[[str], None]
) -> Params:
    """Fits what a human expects to what came of the crew's poses, when each member walked alone.

    Args:
        base: of `base_of`.
        crew: of `train_crew`.
        episodes: that are watched of each member.
        say: is told how much was seen, and the loss at the end.

    Returns:
        Parameters of a `RiskNetwork` of `EXPERIENCE_SIZES`.
    """
    agent = base.team()  # Tests ask it for actors alone, and these are alike.
    seen: list[np.ndarray] = []
    falls: list[np.ndarray] = []
    with make_pool(_backend(base.env), episodes * _SNAPSHOTS, env_id=base.env) as pool:
        examiner = HostExaminer(agent, pool)
        for one in crew:
            run = one.finished.run
            trial = Trial("autonomous", run.spec, run.snapshots, episodes)
            poses, to_fall = _watched(examiner, trial, base.agent.observation_size)
            seen.append(poses)
            falls.append(to_fall <= round(task_of(base.env).steps_per_second))
    poses, fell = np.concatenate(seen), np.concatenate(falls)
    params, loss = _fitted(jnp.asarray(poses), jnp.asarray(fell, jnp.float32), jax.random.key(0))
    say(f"seen {len(poses):,} poses, {fell.mean():.3f} of them within a second of a fall")
    say(f"loss {loss:.4f}")
    return params


def _watched(
    examiner: HostExaminer, trial: Trial, observation_size: int
) -> tuple[np.ndarray, np.ndarray]:
    """Poses [T, O] of all episodes of a trial, one after the other, and the steps to a fall [T]."""
    steps: list[np.ndarray] = []

    def watch(decided: np.ndarray, active: np.ndarray) -> None:
        del active  # The rows tell how long each episode was.
        steps.append(decided[:, :observation_size].copy())

    rows = play_trial(examiner, trial, watch)
    poses = [
        np.stack([step[walker] for step in steps[: row["length"]]])
        for walker, row in enumerate(rows)
    ]
    lengths, fell = [row["length"] for row in rows], [bool(row["fall"]) for row in rows]
    return np.concatenate(poses), steps_to_fall(lengths, fell)


@jax.jit
def _fitted(poses: chex.Array, fell: chex.Array, key: chex.PRNGKey) -> tuple[Params, chex.Array]:
    """A network that is fitted to what came, and its loss at the end."""
    network, first = RiskNetwork(EXPERIENCE_SIZES), jax.random.split(key)
    params = network.init(first[0], poses[:1])

    def loss(params: Params, index: chex.Array) -> chex.Array:
        logits = network.apply(params, poses[index])
        return optax.sigmoid_binary_cross_entropy(logits, fell[index]).mean()

    def step(state: Any, key: chex.PRNGKey) -> tuple[Any, chex.Array]:
        params, optimizer = state
        index = jax.random.randint(key, (_BATCH,), 0, len(poses))
        value, grads = jax.value_and_grad(loss)(params, index)
        return adam.descend(params, grads, optimizer, jnp.float32(_LEARNING_RATE)), value

    state, losses = jax.lax.scan(
        step, (params, adam.init(params)), jax.random.split(first[1], _UPDATES)
    )
    return state[0], losses[-_UPDATES // 10 :].mean()


def mean_return(one: Tested, mode: str) -> float:
    """Mean return of a run's tests alone (`autonomous`), or with the crew (`assisted`)."""
    return float(np.mean([row["return"] for row in one.tests if row["mode"] == mode]))


def best_hands(hands: Sequence[Tested]) -> Tested:
    """Those whose tests with the crew have the greatest return."""
    return max(hands, key=lambda one: mean_return(one, "assisted"))


def relay(expects: Params, observation_size: int) -> HumanPart:
    """Who judges for a crew: dangerous, and so in its hands, from a random step to a stumble.

    Args:
        expects: of `gain_experience`: what tells a stumble.
        observation_size: O.
    """
    logit_of = row_by_row(RiskNetwork(EXPERIENCE_SIZES).apply)

    def judge(
        state: tuple[chex.Array, chex.Array],
        params: HumanParams,
        observation: chex.Array,
        dangerous: chex.Array,
        key: chex.PRNGKey,
    ) -> tuple[tuple[chex.Array, chex.Array], chex.Array]:
        del params, dangerous
        holds, limit = state
        keys = jax.random.split(key, 3)
        logit: chex.Array = logit_of(expects, observation)
        stumbles = jax.nn.sigmoid(logit) >= limit
        gives_back = stumbles | (jax.random.uniform(keys[0]) < _GIVES_BACK)
        begins = (jax.random.uniform(keys[1]) < _BEGINS) & ~stumbles
        least, most = jnp.log(jnp.array(_EXPECTATION))
        fresh = jnp.exp(jax.random.uniform(keys[2], minval=least, maxval=most))
        after = jnp.where(holds, ~gives_back, begins)
        return (after, jnp.where(holds, limit, fresh)), after

    return HumanPart(
        init=lambda: (jnp.zeros((), bool), jnp.full((), _EXPECTATION[0], jnp.float32)),
        begin_episode=lambda state: (jnp.ones((), bool), state[1]),
        judge=judge,
        notify=unmoved,
        observation_size=observation_size,
    )


def crew_actions(
    policies: Sequence[Params], observation_size: int, action_size: int
) -> ActionSource:
    """Actions of a crew, one member after another at random.

    Args:
        policies: parameters of an `Actor`, of equal widths.
        observation_size: O.
        action_size: A.
    """
    every = jax.tree.map(lambda *leaves: np.stack(leaves), *policies)
    *hidden, _ = (
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
        observation_size=observation_size,
        action_size=action_size,
    )
