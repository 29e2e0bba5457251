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
from hitl_jax.training.device_ticks import Moment, begins_with
from hitl_jax.training.stage import Slots
from hitl_jax.training.step_booking import (
    complete,
    episode_of,
    finite_answer,
    logged_layout,
    step_width,
)
from hitl_jax.types import Behavior
from hitl_jax.xla.devices import walker_devices

_TABLE = 16
"""Episodes of one policy that are acted for together."""
_CHUNK = 16
_MOST_WALKERS = {"cpu": 1024}
_MOST_ELSEWHERE = 16_384


def num_walkers(episodes: int, num_devices: int) -> int:
    """Walkers that play so many test episodes well: a power of two a device, at least 32.

    More are of no use. (Two tables at least: of an axis of one XLA makes another program, which
    rounds otherwise.)

    Args:
        episodes: to be played in all.
        num_devices: CPU devices that walkers are shared out over; accelerators are all used.
    """
    devices = walker_devices(num_devices)
    most = _MOST_WALKERS.get(devices[0].platform, _MOST_ELSEWHERE)
    each = -(-min(episodes, most) // len(devices))
    return len(devices) * max(1 << (each - 1).bit_length(), 2 * _TABLE)


class _Policy(NamedTuple):
    """What acting needs to know of a policy under test."""

    hyper: RunHyper
    params: Behavior


class _Seats(NamedTuple):
    """Of T tables: their policies, leaves [T, ...], and acting states, leaves [T, 16, ...]."""

    policies: _Policy
    states: ActingState


class _Guest(NamedTuple):
    """A policy and its episodes, [16], with what their acting begins from; see `init_test`."""

    policy: _Policy
    boundary: chex.Array
    key: chex.PRNGKey
    episodes: chex.Array


class _Sitting(NamedTuple):
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


class DeviceEvaluator:
    """An `Examiner` for walkers on a device: tables of 16 of them, and at each a policy.

    As soon as all episodes at a table have ended, the next ones sit down there, whatever run they
    are of.
    """

    def __init__(self, agent: Agent, pool: JaxPool, num_episodes: int):
        """Compiles lazily.

        Args:
            agent: the team as it trained.
            pool: of `num_walkers`; nobody else may step them.
            num_episodes: of one test.
        """
        self._agent = as_tested(agent)
        self._pool = pool
        self._program = jax.jit(
            functools.partial(_play, self._agent, _CHUNK), donate_argnums=(1, 2)
        )
        self.num_episodes = num_episodes
        self.num_runs = max(pool.num_walkers // num_episodes, 1)

    def play(self, trials: Sequence[Trial], between: Callable[[], None]) -> list[list[Row]]:
        """See `Examiner`."""
        queue = deque(
            _Sitting(number, policy, first, min(first + _TABLE, trial.episodes) - 1)
            for number, trial in enumerate(trials)
            for policy in range(len(trial.policies))
            for first in range(0, trial.episodes, _TABLE)
        )
        rows: list[list[Row]] = [
            [Row() for _ in range(len(trial.policies) * trial.episodes)] for trial in trials
        ]
        rooms = [_Room(self._agent, self._pool, index) for index in range(len(self._pool.blocks))]
        while True:
            for room in rooms:
                room.fill(trials, queue)
            playing = [room for room in rooms if room.busy]
            if not playing:
                return rows
            for room in playing:
                room.start(self._program)
            for room in playing:
                for sitting, place, row in room.finish():
                    trial, episode = trials[sitting.trial], sitting.first + place
                    said = {"mode": trial.mode, "episode": episode + 1, **row}
                    rows[sitting.trial][sitting.policy * trial.episodes + episode] = said
            between()


class _Room:
    """The walkers of one device, L, at their tables."""

    def __init__(self, agent: Agent, pool: JaxPool, index: int):
        self._agent, self._pool, self._index = agent, pool, index
        lanes = len(jax.tree.leaves(pool.walkers[index])[0])
        self._sittings: list[_Sitting | None] = [None] * (lanes // _TABLE)
        self._slots = Slots(
            active=np.zeros(lanes, bool),
            needs_reset=np.zeros(lanes, bool),
            seeds=np.zeros((lanes, 1), np.uint32),
            left=np.ones(lanes, np.int32),
            observation=np.zeros((lanes, pool.observation_size), np.float32),
        )
        self._hypers = [RunHyper()] * lanes
        self._logged = logged_layout(agent.layout)
        self._log = EpisodeLog(lanes, step_width(self._logged))
        self._seats: _Seats | None = None
        self._told: tuple[chex.Array, ...] = ()

    @property
    def busy(self) -> bool:
        """Whether an episode is under way."""
        return bool(self._slots.active.any())

    def fill(self, trials: Sequence[Trial], queue: deque[_Sitting]) -> None:
        """Gives free tables to those who wait."""
        for table in range(len(self._sittings)):
            lanes = slice(table * _TABLE, (table + 1) * _TABLE)
            if queue and not self._slots.active[lanes].any():
                self._sittings[table] = sitting = queue.popleft()
                self._seat(table, lanes, trials[sitting.trial], sitting)

    def _seat(self, table: int, lanes: slice, trial: Trial, sitting: _Sitting) -> None:
        snapshot = trial.policies[sitting.policy]
        hyper = typed(frozen(trial.spec.hyper, human_present=trial.mode == "assisted"))
        guest = _Guest(
            _Policy(hyper, snapshot.behavior),
            snapshot.boundary,
            trial_key(trial.spec),
            sitting.first + np.arange(_TABLE),
        )
        guest = jax.device_put(guest, self._pool.blocks[self._index].device)
        if self._seats is None:
            self._seats = _tables(self._agent, len(self._sittings), guest)
        else:
            self._seats = _seated(self._agent, self._seats, table, guest)
        plays = sitting.first + np.arange(_TABLE) <= sitting.last
        seeds = terrain_seeds(trial.spec, sitting.last + 1)
        self._slots.active[lanes] = self._slots.needs_reset[lanes] = plays
        self._slots.seeds[lanes][plays, 0] = seeds[sitting.first :]
        self._hypers[lanes] = [hyper] * _TABLE

    def start(self, play: Callable[..., Any]) -> None:
        """Begins a chunk, by `_play`; does not wait for it."""
        assert self._seats is not None
        walkers = self._pool.walkers
        device = self._pool.blocks[self._index].device
        states, walkers[self._index], _, self._told = play(
            self._seats.policies,
            self._seats.states,
            walkers[self._index],
            *jax.device_put(begins_with(self._slots), device),
        )
        self._seats = self._seats._replace(states=states)

    def finish(self) -> Iterator[tuple[_Sitting, int, Row]]:
        """Waits for the chunk, and gives the episodes that ended in it."""
        slots, config, layout = self._slots, self._agent.config, self._agent.layout
        for decided, live, *played in zip(*jax.device_get(self._told), strict=True):
            answer, step = StepBatch(*played), np.array(decided)
            finite = np.logical_and(*finite_answer(answer).values())
            lost = slots.active & ~(finite & (live | slots.needs_reset))
            for lane in np.flatnonzero(lost).tolist():
                yield self._ended(lane, lost_test())
            live = live & finite
            ended = live & complete(step, answer, layout)
            self._log.add(live, step[:, layout.action.start :])
            for lane in np.flatnonzero(ended).tolist():
                steps, hyper = self._log.of(lane), self._hypers[lane]
                yield self._ended(lane, row_of(episode_of(steps, self._logged, config, hyper)))
            slots.needs_reset[:] = False
            slots.observation = answer.observation

    def _ended(self, lane: int, row: Row) -> tuple[_Sitting, int, Row]:
        self._slots.active[lane] = False
        self._log.begin(lane)
        table, place = divmod(lane, _TABLE)
        sitting = self._sittings[table]
        assert sitting is not None
        return sitting, place, row


def _table(agent: Agent, guest: _Guest) -> _Seats:
    """One table at the first step of its episodes, policies' leaves [...], states' [16, ...]."""
    one = functools.partial(init_test, agent, guest.policy.hyper, guest.boundary, guest.key)
    return _Seats(guest.policy, jax.vmap(one)(guest.episodes))


@functools.partial(jax.jit, static_argnums=(0, 1))
def _tables(agent: Agent, count: int, guest: _Guest) -> _Seats:
    """The same guest at every table."""
    seats: _Seats = jax.tree.map(lambda leaf: jnp.stack([leaf] * count), _table(agent, guest))
    return seats


@functools.partial(jax.jit, static_argnums=0, donate_argnums=1)
def _seated(agent: Agent, seats: _Seats, table: int, guest: _Guest) -> _Seats:
    """A guest sits down at a table."""
    one = _table(agent, guest)
    after: _Seats = jax.tree.map(lambda leaf, new: leaf.at[table].set(new), seats, one)
    return after


def _play(
    agent: Agent,
    count: int,
    policies: _Policy,
    states: ActingState,
    walkers: chex.ArrayTree,
    begin: Moment,
    seeds: chex.Array,
    first_left: chex.Array,
) -> tuple[ActingState, chex.ArrayTree, Moment, tuple[chex.Array, ...]]:
    """A chunk of ticks of L walkers at T tables; see `device_ticks.play`."""
    step = functools.partial(packed_decision.act_or_begin, agent)
    table = jax.vmap(step, in_axes=(None, None, 0, 0, 0))

    def act(
        states: ActingState, observation: chex.Array, live: chex.Array
    ) -> tuple[ActingState, chex.Array]:
        seen, stepping = (a.reshape(-1, _TABLE, *a.shape[1:]) for a in (observation, live))
        after, decided = jax.vmap(table)(*policies, states, seen, stepping)

        def unless_idle(new: chex.Array, old: chex.Array) -> chex.Array:
            # An episode has begun already, by `init_test`.
            return jnp.where(stepping.reshape(*stepping.shape, *[1] * (old.ndim - 2)), new, old)

        states = jax.tree.map(unless_idle, after, states)
        return states, decided.reshape(len(live), -1)

    return device_ticks.play(act, agent.layout, count, states, walkers, begin, seeds, first_left)
