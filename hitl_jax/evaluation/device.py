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
from hitl_jax.evaluation.trials import Trial, as_tested, frozen, init_test, terrain_seeds
from hitl_jax.learner.frame import Layout
from hitl_jax.results.episode_measures import Row, lost_test, row_of
from hitl_jax.team import packed_decision
from hitl_jax.team.acting import ActingState
from hitl_jax.team.agent import Agent
from hitl_jax.training import batch_arrays, device_ticks
from hitl_jax.training.device_ticks import ChunkStart
from hitl_jax.training.run_spec import method_index
from hitl_jax.training.step_booking import episode_of
from hitl_jax.types import Behavior
from hitl_jax.xla.devices import walker_devices

_GROUP = 16
"""Episodes of one policy that are acted for together."""
_CHUNK = 16
_PUT = 16
"""Groups that are begun by one call."""
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
    """What G groups begin a chunk with.

    Attributes:
        policies: leaves [G, ...].
        acting: acting states, leaves [G, 16, ...].
        begin: of the walkers, leaves [G, 16, ...].
        seeds: of their resets, uint32 [G, 16].
    """

    policies: _Policy
    acting: ActingState
    begin: ChunkStart
    seeds: chex.Array


class _GroupStart(NamedTuple):
    """A policy and its episodes, with what their acting begins from; see `init_test`.

    Attributes:
        policy: leaves [...].
        boundary: the boundary source's carry, [] or [C].
        run: seed and method of the run, see `batch_arrays.traced_run_keys`, uint32 [2].
        episodes: their numbers, [16].
        plays: whether an episode is one of the test's, bool [16].
        seeds: of their resets, uint32 [16].
    """

    policy: _Policy
    boundary: chex.Array
    run: chex.Array
    episodes: chex.Array
    plays: chex.Array
    seeds: chex.Array


class _Told(NamedTuple):
    """What L walkers did in a chunk of U ticks.

    Attributes:
        steps: from the action on, with what the walkers answered, [L, U, A + 13].
        stepped: whether that is a step of an episode, bool [L, U].
        ended: whether an episode ended, bool [L].
        lost: whether one met a number that is not finite, bool [L].
    """

    steps: chex.Array
    stepped: chex.Array
    ended: chex.Array
    lost: chex.Array


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

    When all episodes of a group have ended, its walkers play the next ones in the queue, whatever
    run they are of. A chunk is played while the host books the one before.
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
            functools.partial(_play, self._agent, _CHUNK), donate_argnums=(1, 2, 4)
        )
        # Kept from test to test: what they have grown to is not made anew.
        width = self._agent.layout.without_observation.step_width
        self._logs = [EpisodeLog(pool.lanes, width) for _ in pool.blocks]
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
            _DeviceWalkers(self._agent, self._trained, self._pool, index, log)
            for index, log in enumerate(self._logs)
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

    def __init__(self, agent: Agent, trained: Agent, pool: JaxPool, index: int, log: EpisodeLog):
        self._agent, self._trained, self._pool, self._index = agent, trained, pool, index
        self._log, lanes = log, pool.lanes
        self._groups: list[_Group | None] = [None] * (lanes // _GROUP)
        self._active = np.zeros(lanes, bool)  # Of what is booked.
        self._hypers = [RunHyper()] * lanes
        self._logged = agent.layout.without_observation
        self._states: _GroupStates | None = None
        self._told: deque[_Told] = deque()

    @property
    def busy(self) -> bool:
        """Whether an episode is under way."""
        return bool(self._active.any())

    def fill(self, trials: Sequence[Trial], queue: deque[_Group]) -> None:
        """Gives the groups whose episodes have all ended to the next in the queue."""
        idle = np.flatnonzero(~self._active.reshape(-1, _GROUP).any(axis=1))
        starts = []
        for place in idle[: len(queue)].tolist():
            self._groups[place] = group = queue.popleft()
            starts.append((place, self._begin(place, trials[group.trial], group)))
        device = self._pool.blocks[self._index].device
        for first in range(0, len(starts), _PUT):
            some = starts[first : first + _PUT]
            some += some[-1:] * (_PUT - len(some))  # One number of them, so one program.
            places, several = zip(*some, strict=True)
            begun = jax.device_put(jax.tree.map(lambda *leaves: np.stack(leaves), *several), device)
            if self._states is None:
                self._states = _waiting(self._agent, len(self._groups), begun)
            self._states = _put(self._agent, self._states, np.array(places), begun)

    def _begin(self, place: int, trial: Trial, group: _Group) -> _GroupStart:
        snapshot, spec = trial.policies[group.policy], trial.spec
        # As it was trained, with all options: policies side by side have the same numbers.
        given = self._trained.with_extra(spec.hyper)
        hyper = typed(frozen(given, human_present=trial.mode == "assisted"))
        episodes = range(group.first, group.first + _GROUP)
        lanes = slice(place * _GROUP, (place + 1) * _GROUP)
        self._hypers[lanes] = [hyper] * _GROUP
        for lane in range(lanes.start, lanes.stop):
            self._log.begin(lane)
        self._active[lanes] = plays = np.array(episodes) <= group.last
        return _GroupStart(
            policy=_Policy(hyper, snapshot.behavior),
            boundary=snapshot.boundary,
            run=np.array([spec.seed, method_index(spec.method)], np.uint32),
            episodes=np.array(episodes),
            plays=plays,
            seeds=terrain_seeds(spec, episodes),
        )

    def start(self, play: Callable[..., Any]) -> None:
        """Begins a chunk, by `_play`; does not wait for it."""
        assert self._states is not None
        walkers = self._pool.walkers
        acting, begin, walkers[self._index], told = play(*self._states, walkers[self._index])
        self._states = self._states._replace(acting=acting, begin=begin)
        self._told.append(told)

    def finish(self) -> Iterator[tuple[_Group, int, Row]]:
        """Waits for the chunk before the last, and gives the episodes that ended in it."""
        if len(self._told) < 2:
            return
        told = jax.device_get(self._told.popleft())
        self._log.add_several(told.stepped, told.steps)
        for lane in np.flatnonzero(told.lost).tolist():
            yield self._ended(lane, lost_test())
        config, ends = self._agent.config, self._pool.ends
        for lane in np.flatnonzero(told.ended).tolist():
            episode = episode_of(self._log.of(lane), self._logged, config, self._hypers[lane])
            yield self._ended(lane, row_of(episode, ends))

    def _ended(self, lane: int, row: Row) -> tuple[_Group, int, Row]:
        self._active[lane] = False
        number, place = divmod(lane, _GROUP)
        group = self._groups[number]
        assert group is not None
        return group, place, row


def _begun(agent: Agent, start: _GroupStart) -> _GroupStates:
    """One group at the first step of its episodes, policy leaves [...], others [16, ...]."""
    *_, key = batch_arrays.traced_run_keys(*start.run)
    one = functools.partial(init_test, agent, start.policy.hyper, start.boundary, key)
    begin = ChunkStart(
        active=start.plays,
        needs_reset=start.plays,
        left=jnp.ones(_GROUP, jnp.int32),
        observation=jnp.zeros((_GROUP, agent.layout.observation_size), jnp.float32),
    )
    return _GroupStates(start.policy, jax.vmap(one)(start.episodes), begin, start.seeds)


@functools.partial(jax.jit, static_argnums=(0, 1))
def _waiting(agent: Agent, count: int, starts: _GroupStart) -> _GroupStates:
    """Groups that play nothing, each with the first policy of several."""
    begun = _begun(agent, jax.tree.map(lambda leaf: leaf[0], starts))
    states: _GroupStates = jax.tree.map(
        lambda leaf: jnp.broadcast_to(leaf, (count, *leaf.shape)), begun
    )
    idle = jnp.zeros((count, _GROUP), bool)
    return states._replace(begin=states.begin._replace(active=idle, needs_reset=idle))


@functools.partial(jax.jit, static_argnums=0, donate_argnums=1)
def _put(
    agent: Agent, states: _GroupStates, places: chex.Array, starts: _GroupStart
) -> _GroupStates:
    """Starts, leaves [K, ...], put in the places of groups, [K]."""
    begun = jax.vmap(functools.partial(_begun, agent))(starts)
    after: _GroupStates = jax.tree.map(lambda leaf, new: leaf.at[places].set(new), states, begun)
    return after


def _play(
    agent: Agent,
    count: int,
    policies: _Policy,
    acting: ActingState,
    begin: ChunkStart,
    seeds: chex.Array,
    walkers: chex.ArrayTree,
) -> tuple[ActingState, ChunkStart, chex.ArrayTree, _Told]:
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

    flat = ChunkStart(*(leaf.reshape(-1, *leaf.shape[2:]) for leaf in begin))
    first_left = jnp.ones_like(flat.left)
    acting, walkers, end, (decided, live, *played) = device_ticks.play(
        act, agent.layout, count, acting, walkers, flat, seeds.reshape(-1, 1), first_left
    )
    ended = flat.left > end.left
    told = _Told(
        steps=_logged(decided, StepBatch(*played), agent.layout),
        stepped=live.T,
        ended=ended,
        lost=flat.active & ~end.active & ~ended,
    )
    begin = ChunkStart(*(leaf.reshape(-1, _GROUP, *leaf.shape[1:]) for leaf in end))
    return acting, begin, walkers, told


def _logged(decided: chex.Array, answer: StepBatch, layout: Layout) -> chex.Array:
    """What is logged of ticks [U, L, W + 6], [L, U, A + 13]."""
    columns = {
        layout.reward: answer.reward,
        layout.terminated: answer.terminated,
        layout.truncated: answer.truncated,
    }
    for column, values in columns.items():
        decided = decided.at[..., column].set(values.astype(decided.dtype))
    return decided[..., layout.action.start :].swapaxes(0, 1)
