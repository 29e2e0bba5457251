"""Test episodes of many runs at once, by one program on the device."""

import functools
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np

from hitl_jax.config import RunHyper, typed
from hitl_jax.envs.episode_log import EpisodeLog
from hitl_jax.envs.jax_pool import JaxPool
from hitl_jax.evaluation.trials import Trial, as_tested, frozen, terrain_seeds
from hitl_jax.evaluation.walker_groups import (
    GROUP,
    GroupStart,
    GroupStates,
    Policy,
    Told,
    play_groups,
    put,
    waiting,
)
from hitl_jax.results.episode_measures import Row, lost_test, row_of
from hitl_jax.team.agent import Agent
from hitl_jax.training.run_spec import method_index
from hitl_jax.training.step_booking import episode_of
from hitl_jax.xla.devices import walker_devices

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
    return len(devices) * max(1 << (each - 1).bit_length(), 2 * GROUP)


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
            functools.partial(play_groups, self._agent, _CHUNK), donate_argnums=(1, 2, 4)
        )
        # Kept from test to test: what they have grown to is not made anew.
        width = self._agent.layout.without_observation.step_width
        self._logs = [EpisodeLog(pool.lanes, width) for _ in pool.blocks]
        self.num_episodes = num_episodes
        self.num_runs = max(pool.num_walkers // num_episodes, 1)

    def play(self, trials: Sequence[Trial], between: Callable[[], None]) -> list[list[Row]]:
        """See `Examiner`."""
        queue = deque(
            _Group(number, policy, first, min(first + GROUP, trial.episodes) - 1)
            for number, trial in enumerate(trials)
            for policy in range(len(trial.policies))
            for first in range(0, trial.episodes, GROUP)
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
        self._groups: list[_Group | None] = [None] * (lanes // GROUP)
        self._active = np.zeros(lanes, bool)  # Of what is booked.
        self._hypers = [RunHyper()] * lanes
        self._logged = agent.layout.without_observation
        self._states: GroupStates | None = None
        self._told: deque[Told] = deque()

    @property
    def busy(self) -> bool:
        """Whether an episode is under way."""
        return bool(self._active.any())

    def fill(self, trials: Sequence[Trial], queue: deque[_Group]) -> None:
        """Gives the groups whose episodes have all ended to the next in the queue."""
        idle = np.flatnonzero(~self._active.reshape(-1, GROUP).any(axis=1))
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
                self._states = waiting(self._agent, len(self._groups), begun)
            self._states = put(self._agent, self._states, np.array(places), begun)

    def _begin(self, place: int, trial: Trial, group: _Group) -> GroupStart:
        snapshot, spec = trial.policies[group.policy], trial.spec
        # As it was trained, with all options: policies side by side have the same numbers.
        given = self._trained.with_extra(spec.hyper)
        hyper = typed(frozen(given, human_present=trial.mode == "assisted"))
        episodes = range(group.first, group.first + GROUP)
        lanes = slice(place * GROUP, (place + 1) * GROUP)
        self._hypers[lanes] = [hyper] * GROUP
        for lane in range(lanes.start, lanes.stop):
            self._log.begin(lane)
        self._active[lanes] = plays = np.array(episodes) <= group.last
        return GroupStart(
            policy=Policy(hyper, snapshot.behavior),
            boundary=snapshot.boundary,
            run=np.array([spec.seed, method_index(spec.method)], np.uint32),
            episodes=np.array(episodes),
            plays=plays,
            seeds=terrain_seeds(spec, episodes),
        )

    def start(self, play: Callable[..., Any]) -> None:
        """Begins a chunk, by `play_groups`; does not wait for it."""
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
        number, place = divmod(lane, GROUP)
        group = self._groups[number]
        assert group is not None
        return group, place, row
