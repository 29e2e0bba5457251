"""The test phase (Fig. 5): a trained walker over many episodes, noise off, alone and helped."""

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Literal

import jax
import numpy as np

from hitl_jax import batch, decisions
from hitl_jax.acting import ActingState, init_acting
from hitl_jax.agent import Agent, behavior
from hitl_jax.config import RunHyper
from hitl_jax.devices import acting_device
from hitl_jax.envs import Command, WalkerPool
from hitl_jax.episodes import EpisodeCounter, Row, Step, fall_at_once
from hitl_jax.runs import FinishedRun, Run, RunSpec, Snapshot, episode_seed, method_index
from hitl_jax.types import Behavior

Mode = Literal["autonomous", "assisted"]

Watch = Callable[[np.ndarray, np.ndarray], None]
"""Called before each step of a test with what was decided, a frame and flags of `decisions`,
[N, W + 6], and which walkers take the step, bool [N]."""

_PARTS = 5


def milestones(episodes: int) -> tuple[int, ...]:
    """Numbers of training episodes at which a run is tested before its end: its fifths."""
    points = (episodes * part // _PARTS for part in range(1, _PARTS))
    return tuple(sorted({point for point in points if point > 0}))


class Evaluator:
    """Plays test episodes of one run at a time, a walker for each episode.

    Everything is frozen: no exploration, no learning, the boundary as training left it.
    `autonomous`: nobody intervenes; alarms and judgements are recorded all the same. `assisted`:
    arbiter and human are on, and an intervention is a takeover, whatever it was in training, since
    a test is not reset.
    """

    def __init__(self, agent: Agent, pool: WalkerPool):
        """Compiles lazily.

        Args:
            agent: the team as it trained.
            pool: one walker for each episode.
        """
        config = dataclasses.replace(agent.config, intervention="takeover")
        self._agent = agent._replace(config=config)
        self._pool = pool

    @property
    def num_episodes(self) -> int:
        """Episodes of one test: the pool's walkers."""
        return self._pool.num_walkers

    def evaluate(
        self,
        mode: Mode,
        hyper: RunHyper,
        params: Behavior,
        boundary: np.ndarray,
        key: jax.Array,
        seeds: np.ndarray,
        watch: Watch | None = None,
    ) -> list[Row]:
        """Plays one episode on each walker, all of K policies of one run.

        Args:
            mode: `autonomous` or `assisted`.
            hyper: the run's hyperparameters, scalars.
            params: trained parameters, leaves [K, ...].
            boundary: the boundary source's carry of each policy, [K] or [K, C].
            key: consumed.
            seeds: reset seeds of each policy's episodes, uint32 [K, E], K · E at most the pool's
                walkers.
            watch: sees every step.

        Returns:
            A row for each episode, policy after policy.
        """
        hyper = frozen(hyper, human_present=mode == "assisted")
        # Committed to the acting device, the programs run there, a GPU or not.
        hyper, params, key = jax.device_put((hyper, params, key), acting_device())
        state = _init(self._agent, hyper, boundary, key, np.arange(seeds.shape[1]))
        layout = self._agent.layout
        walkers = self._pool.num_walkers
        counter = EpisodeCounter(walkers)
        rows: list[Row | None] = [None] * walkers
        active = np.arange(walkers) < seeds.size
        action = np.zeros((walkers, layout.action_size), np.float32)
        decided = np.zeros((walkers, layout.width + len(decisions.EXTRA_COLUMNS)), np.float32)
        resets = np.zeros(walkers, np.uint32)
        resets[: seeds.size] = seeds.ravel()
        command = np.where(active, Command.RESET, Command.IDLE).astype(np.uint8)
        observation = self._pool.step(command, action, resets).observation
        while active.any():
            seen = observation[: seeds.size].reshape(*seeds.shape, -1)
            live = active[: seeds.size].reshape(seeds.shape)
            state, packed = _act(self._agent, hyper, params, state, seen, live)
            decided[: seeds.size] = np.asarray(packed).reshape(seeds.size, -1)
            # A policy of numbers that are not finite cannot act.
            unable = active & ~np.isfinite(decided).all(axis=1)
            for walker in np.flatnonzero(unable).tolist():
                place = {"mode": mode, "episode": walker % seeds.shape[1] + 1}
                rows[walker] = place | fall_at_once()
            active = active & ~unable
            if watch is not None:
                watch(decided, active)
            command = np.where(active, Command.STEP, Command.IDLE).astype(np.uint8)
            answer = self._pool.step(command, decided[:, layout.action], resets)
            flags = decisions.flags_of(decided, layout)
            known = hyper.has_arbiter > 0
            step = Step(
                live=active,
                reward=answer.reward,
                shaped=answer.reward,  # nothing is learned from a test
                terminated=answer.terminated,
                truncated=answer.truncated,
                human_reset=np.zeros(walkers, bool),
                control=flags["control"],
                human_action=flags["human_action"],
                began=flags["began"],
                alarmed=flags["alarmed"],
                dangerous=flags["dangerous"],
                boundary=decided[:, layout.boundary] if known else np.full(walkers, np.nan),
            )
            for walker, row in counter.count(step):
                rows[walker] = {"mode": mode, "episode": walker % seeds.shape[1] + 1, **row}
                active[walker] = False
            observation = answer.observation
        return [row for row in rows if row is not None]


@functools.partial(jax.jit, static_argnums=0)
def _init(
    agent: Agent, hyper: RunHyper, boundary: jax.Array, key: jax.Array, episodes: jax.Array
) -> ActingState:
    """Acting states, leaves [K, E, ...]; an episode's key depends on nothing else."""

    def one(boundary: jax.Array, episode: jax.Array) -> ActingState:
        state = init_acting(agent, hyper, jax.random.fold_in(key, episode))
        return dataclasses.replace(state, boundary=boundary)

    policies = jax.vmap(one, in_axes=(None, 0))
    return jax.vmap(policies, in_axes=(0, None))(boundary, episodes)


@functools.partial(jax.jit, static_argnums=0)
def _act(
    agent: Agent,
    hyper: RunHyper,
    params: Behavior,
    state: ActingState,
    observation: jax.Array,
    live: jax.Array,
) -> tuple[ActingState, jax.Array]:
    """A step of E episodes with each of K policies, leaves [K, E, ...]."""
    step = functools.partial(decisions.act_or_begin, agent)
    episodes = jax.vmap(step, in_axes=(None, None, 0, 0, 0))
    everything = jax.vmap(episodes, in_axes=(None, 0, 0, 0, 0))
    return everything(hyper, params, state, observation, live)


def evaluate_run(
    evaluator: Evaluator,
    finished: FinishedRun,
    modes: Sequence[Mode],
    watch: Watch | None = None,
) -> list[Row]:
    """Tests a run as training left it; one that diverged counts as falling at once.

    The terrain depends on the seed alone: a comparison that is paired over methods needs fewer
    episodes.

    Args:
        evaluator: plays an episode on each of its walkers.
        finished: the run.
        modes: which tests, in this order.
        watch: sees every step.

    Returns:
        A row for each mode and episode.
    """
    last = Snapshot(finished.run.spec.episodes, behavior(finished.train), finished.boundary)
    spec = finished.run.spec
    return [
        row for mode in modes for row in evaluate_policies(evaluator, mode, spec, [last], watch)
    ]


def evaluate_snapshots(evaluator: Evaluator, run: Run, watch: Watch | None = None) -> list[Row]:
    """Tests a run, alone, as it was at its snapshots; they share the evaluator's walkers.

    Of N walkers each of K snapshots gets ⌊N / K⌋, on the first terrains of the test at the end;
    with fewer walkers than snapshots each gets one.

    Args:
        evaluator: plays an episode on each of its walkers.
        run: with the snapshots.
        watch: sees every step.

    Returns:
        A row for each snapshot and episode, with the number of training episodes as `trained`.
    """
    rows = []
    for first in range(0, len(run.snapshots), evaluator.num_episodes):
        group = run.snapshots[first : first + evaluator.num_episodes]
        played = evaluate_policies(evaluator, "autonomous", run.spec, group, watch)
        each = len(played) // len(group)
        rows += [{"trained": group[n // each].episode, **row} for n, row in enumerate(played)]
    if run.diverged:
        lost = run.diverged.episodes
        rows = [row | fall_at_once() if row["trained"] > lost else row for row in rows]
    return rows


def evaluate_policies(
    evaluator: Evaluator,
    mode: Mode,
    spec: RunSpec,
    policies: Sequence[Snapshot],
    watch: Watch | None = None,
) -> list[Row]:
    """One test of some of a run's policies, each on the same terrains.

    Args:
        evaluator: its walkers are shared out among the policies.
        mode: `autonomous` or `assisted`.
        spec: the run.
        policies: at most as many as walkers.
        watch: sees every step.

    Returns:
        A row for each policy and episode.
    """
    *_, key = batch.run_keys(spec.seed, method_index(spec.method))
    stacked = jax.tree.map(lambda *leaves: np.stack(leaves), *policies)
    numbers = range(evaluator.num_episodes // len(policies))
    seeds = np.array([episode_seed("test", spec.seed, number) for number in numbers], np.uint32)
    everywhere = np.tile(seeds, (len(policies), 1))
    return evaluator.evaluate(
        mode, spec.hyper, stacked.behavior, stacked.boundary, key, everywhere, watch
    )


def frozen(hyper: RunHyper, human_present: bool) -> RunHyper:
    """The hyperparameters of a test: no exploration, no movement of the boundary."""
    return dataclasses.replace(
        hyper,
        human_present=float(human_present),
        exploration_noise=0.0,
        boundary_noise=0.0,
        warmup_steps=0,
        delta_minus=0.0,
        delta_plus=0.0,
    )
