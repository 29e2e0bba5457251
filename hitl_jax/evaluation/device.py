"""Test episodes of many runs at once, by one program on the device."""

import functools
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import chex
import jax
import jax.numpy as jnp
import numpy as np

from hitl_jax.config import RunHyper, typed
from hitl_jax.envs import StepBatch
from hitl_jax.envs.episode_log import EpisodeLog
from hitl_jax.envs.jax_pool import JaxPool
from hitl_jax.evaluation.trials import Trial, as_tested, frozen, init_test, terrain_seeds, trial_key
from hitl_jax.results.episode_measures import Row, lost_test, row_of
from hitl_jax.team import packed_decision
from hitl_jax.team.acting import ActingState
from hitl_jax.team.agent import Agent
from hitl_jax.training import device_ticks
from hitl_jax.training.device_ticks import ChunkStart, begins_with
from hitl_jax.training.stage import Slots
from hitl_jax.training.step_booking import end_of_step, episode_of, write_answer
from hitl_jax.types import Behavior
from hitl_jax.xla.devices import walker_devices

_GROUP = 16
"""Episodes of one policy that are acted for together."""
_CHUNK = 16
_MOST_WALKERS = {"cpu": 1024}
_MOST_ELSEWHERE = 16_384


def num_walkers(episodes: int, num_devices: int) -> int:
    """Walkers that play so many test episodes well: a power of two a device, at least 32.

    More are of no use. (Two groups at least: of an axis of one XLA makes another program, which
    rounds otherwise.)

    Args:
        episodes: to be played in all.
        num_devices: CPU devices that walkers are shared out over; accelerators are all used.
    """
    devices = walker_devices(num_devices)
    most = _MOST_WALKERS.get(devices[0].platform, _MOST_ELSEWHERE)
    each = -(-min(episodes, most) // len(devices))
    return len(devices) * max(1 << (each - 1).bit_length(), 2 * _GROUP)


class _Policy(NamedTuple):
    """What acting needs to know of a policy under test."""

    hyper: RunHyper
    params: Behavior


class _GroupStates(NamedTuple):
    """Policies of G groups, leaves [G, ...], and their acting states, leaves [G, 16, ...]."""

    policies: _Policy
    states: ActingState


class _GroupStart(NamedTuple):
    """A policy and its episodes, [16], with what their acting begins from; see `init_test`."""

    policy: _Policy
    boundary: chex.Array
    key: chex.PRNGKey
    episodes: chex.Array


class _Group(NamedTuple):
    """Episodes of one policy.

    Attributes:
        trial: index of the trial.
        policy: index in it.
        first: number of the first episode.
        last: of the last; at most 16 are played.
    """

    trial: int
    policy: int
    first: int
    last: int


class DeviceExaminer:
    """An `Examiner` for walkers on a device: groups of 16, each of which plays one policy.

    As soon as all episodes of a group have ended, its walkers play the next ones in the queue,
    whatever run they are of.
    """

    def __init__(self, agent: Agent, pool: JaxPool, num_episodes: int):
        """Compiles lazily.

        Args:
            agent: the team as it trained.
            pool: of `num_walkers`; nobody else may step them.
            num_episodes: of one test.
        """
        self._agent, self._trained = as_tested(agent), agent
        self._pool = pool
        self._program = jax.jit(
            functools.partial(_play, self._agent, _CHUNK), donate_argnums=(1, 2)
        )
        self.num_episodes = num_episodes
        self.num_runs = max(pool.num_walkers // num_episodes, 1)

    def play(self, trials: Sequence[Trial], between: Callable[[], None]) -> list[list[Row]]:
        """See `Examiner`."""
        queue = deque(
            _Group(number, policy, first, min(first + _GROUP, trial.episodes) - 1)
            for number, trial in enumerate(trials)
            for policy in range(len(trial.policies))
            for first in range(0, trial.episodes, _GROUP)
        )
        rows: list[list[Row]] = [
            [Row() for _ in range(len(trial.policies) * trial.episodes)] for trial in trials
        ]
        blocks = [
            _DeviceWalkers(self._agent, self._trained, self._pool, index)
            for index in range(len(self._pool.blocks))
        ]
        while True:
            for block in blocks:
                block.fill(trials, queue)
            playing = [block for block in blocks if block.busy]
            if not playing:
                return rows
            for block in playing:
                block.start(self._program)
            for block in playing:
                for group, place, row in block.finish():
                    trial, episode = trials[group.trial], group.first + place
                    said = {"mode": trial.mode, "episode": episode + 1, **row}
                    rows[group.trial][group.policy * trial.episodes + episode] = said
            between()


class _DeviceWalkers:
    """The walkers of one device, L, in groups of 16."""

    def __init__(self, agent: Agent, trained: Agent, pool: JaxPool, index: int):
        self._agent, self._trained, self._pool, self._index = agent, trained, pool, index
        lanes = len(jax.tree.leaves(pool.walkers[index])[0])
        self._groups: list[_Group | None] = [None] * (lanes // _GROUP)
        self._slots = Slots(
            active=np.zeros(lanes, bool),
            needs_reset=np.zeros(lanes, bool),
            seeds=np.zeros((lanes, 1), np.uint32),
            left=np.ones(lanes, np.int32),
            observation=np.zeros((lanes, pool.observation_size), np.float32),
        )
        self._hypers = [RunHyper()] * lanes
        self._logged = agent.layout.without_observation
        self._log = EpisodeLog(lanes, self._logged.step_width)
        self._states: _GroupStates | None = None
        self._told: tuple[chex.Array, ...] = ()

    @property
    def busy(self) -> bool:
        """Whether an episode is under way."""
        return bool(self._slots.active.any())

    def fill(self, trials: Sequence[Trial], queue: deque[_Group]) -> None:
        """Gives the groups whose episodes have all ended to the next in the queue."""
        for place in range(len(self._groups)):
            lanes = slice(place * _GROUP, (place + 1) * _GROUP)
            if queue and not self._slots.active[lanes].any():
                self._groups[place] = group = queue.popleft()
                self._begin(place, lanes, trials[group.trial], group)

    def _begin(self, place: int, lanes: slice, trial: Trial, group: _Group) -> None:
        snapshot = trial.policies[group.policy]
        # As it was trained, with all options: policies side by side have the same numbers.
        given = self._trained.with_extra(trial.spec.hyper)
        hyper = typed(frozen(given, human_present=trial.mode == "assisted"))
        start = _GroupStart(
            _Policy(hyper, snapshot.behavior),
            snapshot.boundary,
            trial_key(trial.spec),
            group.first + np.arange(_GROUP),
        )
        start = jax.device_put(start, self._pool.blocks[self._index].device)
        if self._states is None:
            self._states = _repeated(self._agent, len(self._groups), start)
        else:
            self._states = _put(self._agent, self._states, place, start)
        plays = group.first + np.arange(_GROUP) <= group.last
        seeds = terrain_seeds(trial.spec, group.last + 1)
        self._slots.active[lanes] = self._slots.needs_reset[lanes] = plays
        self._slots.seeds[lanes][plays, 0] = seeds[group.first :]
        self._hypers[lanes] = [hyper] * _GROUP

    def start(self, play: Callable[..., Any]) -> None:
        """Begins a chunk, by `_play`; does not wait for it."""
        assert self._states is not None
        walkers = self._pool.walkers
        device = self._pool.blocks[self._index].device
        states, walkers[self._index], _, self._told = play(
            self._states.policies,
            self._states.states,
            walkers[self._index],
            *jax.device_put(begins_with(self._slots), device),
        )
        self._states = self._states._replace(states=states)

    def finish(self) -> Iterator[tuple[_Group, int, Row]]:
        """Waits for the chunk, and gives the episodes that ended in it."""
        slots, config, layout = self._slots, self._agent.config, self._agent.layout
        for decided, live, *played in zip(*jax.device_get(self._told), strict=True):
            answer, step = StepBatch(*played), np.array(decided)
            begins = slots.active & slots.needs_reset
            end = end_of_step(step, answer, layout, live, begins)
            # Who neither steps nor begins had decided something that is not finite.
            lost = slots.active & ~(end.sound & (live | begins))
            for lane in np.flatnonzero(lost).tolist():
                yield self._ended(lane, lost_test())
            write_answer(step, answer, layout)
            self._log.add(live & end.sound, step[:, layout.action.start :])
            for lane in np.flatnonzero(end.ended).tolist():
                steps, hyper = self._log.of(lane), self._hypers[lane]
                yield self._ended(
                    lane, row_of(episode_of(steps, self._logged, config, hyper), self._pool.ends)
                )
            slots.needs_reset[:] = False
            slots.observation = answer.observation

    def _ended(self, lane: int, row: Row) -> tuple[_Group, int, Row]:
        self._slots.active[lane] = False
        self._log.begin(lane)
        number, place = divmod(lane, _GROUP)
        group = self._groups[number]
        assert group is not None
        return group, place, row


def _begun(agent: Agent, start: _GroupStart) -> _GroupStates:
    """One group at the first step of its episodes, policy leaves [...], states [16, ...]."""
    one = functools.partial(init_test, agent, start.policy.hyper, start.boundary, start.key)
    return _GroupStates(start.policy, jax.vmap(one)(start.episodes))


@functools.partial(jax.jit, static_argnums=(0, 1))
def _repeated(agent: Agent, count: int, start: _GroupStart) -> _GroupStates:
    """The same start for every group."""
    states: _GroupStates = jax.tree.map(
        lambda leaf: jnp.stack([leaf] * count), _begun(agent, start)
    )
    return states


@functools.partial(jax.jit, static_argnums=0, donate_argnums=1)
def _put(agent: Agent, states: _GroupStates, place: int, start: _GroupStart) -> _GroupStates:
    """A start put in the place of one group."""
    one = _begun(agent, start)
    after: _GroupStates = jax.tree.map(lambda leaf, new: leaf.at[place].set(new), states, one)
    return after


def _play(
    agent: Agent,
    count: int,
    policies: _Policy,
    states: ActingState,
    walkers: chex.ArrayTree,
    begin: ChunkStart,
    seeds: chex.Array,
    first_left: chex.Array,
) -> tuple[ActingState, chex.ArrayTree, ChunkStart, tuple[chex.Array, ...]]:
    """A chunk of ticks of L walkers in G groups; see `device_ticks.play`."""
    step = functools.partial(packed_decision.act_or_begin, agent)
    group = jax.vmap(step, in_axes=(None, None, 0, 0, 0))

    def act(
        states: ActingState, observation: chex.Array, live: chex.Array
    ) -> tuple[ActingState, chex.Array]:
        seen, stepping = (a.reshape(-1, _GROUP, *a.shape[1:]) for a in (observation, live))
        after, decided = jax.vmap(group)(*policies, states, seen, stepping)

        def unless_idle(new: chex.Array, old: chex.Array) -> chex.Array:
            # An episode has begun already, by `init_test`.
            return jnp.where(stepping.reshape(*stepping.shape, *[1] * (old.ndim - 2)), new, old)

        states = jax.tree.map(unless_idle, after, states)
        return states, decided.reshape(len(live), -1)

    return device_ticks.play(act, agent.layout, count, states, walkers, begin, seeds, first_left)
