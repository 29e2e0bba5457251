"""The test phase (Fig. 5): a trained walker over many episodes, noise off, alone and helped."""

import dataclasses
import functools
from collections.abc import Sequence
from typing import Literal

import jax
import numpy as np

from hitl_jax import batch
from hitl_jax.acting import ActingState, init_acting
from hitl_jax.agent import Agent
from hitl_jax.config import RunHyper
from hitl_jax.devices import acting_device
from hitl_jax.envs import Command, WalkerPool
from hitl_jax.episodes import EpisodeCounter, Row, Step
from hitl_jax.rollout import FinishedRun, episode_seed, method_index
from hitl_jax.types import Behavior

Mode = Literal["autonomous", "assisted"]


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
        step = functools.partial(batch.act_or_begin, self._agent)
        self._act = jax.jit(jax.vmap(step, in_axes=(None, None, 0, 0, 0)))
        self._init = jax.jit(self._init_acting)

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
    ) -> list[Row]:
        """Plays one episode on each walker.

        Args:
            mode: `autonomous` or `assisted`.
            hyper: the run's hyperparameters, scalars.
            params: the trained parameters.
            boundary: the boundary source's carry at the end of training, [] or [K].
            key: consumed.
            seeds: reset seeds of the episodes, uint32 [N], N the pool's walkers.

        Returns:
            A row for each episode, in the order of `seeds`.
        """
        hyper = frozen(hyper, human_present=mode == "assisted")
        # Committed to the acting device, the programs run there, a GPU or not.
        hyper, params, key = jax.device_put((hyper, params, key), acting_device())
        state = self._init(hyper, boundary, key, np.arange(len(seeds)))
        layout = self._agent.layout
        counter = EpisodeCounter(len(seeds))
        rows: list[Row | None] = [None] * len(seeds)
        active = np.ones(len(seeds), bool)
        action = np.zeros((len(seeds), layout.action_size), np.float32)
        command = np.full(len(seeds), Command.RESET, np.uint8)
        observation = self._pool.step(command, action, seeds).observation
        while active.any():
            state, packed = self._act(hyper, params, state, observation, active)
            decided = np.asarray(packed)
            command = np.where(active, Command.STEP, Command.IDLE).astype(np.uint8)
            answer = self._pool.step(command, decided[:, layout.action], seeds)
            flags = batch.flags_of(decided, layout)
            known = hyper.has_arbiter > 0
            step = Step(
                live=active,
                reward=answer.reward,
                shaped=answer.reward,  # nothing is learned from a test
                terminated=answer.terminated,
                truncated=answer.truncated,
                human_reset=np.zeros(len(seeds), bool),
                control=flags["control"],
                human_action=flags["human_action"],
                began=flags["began"],
                alarmed=flags["alarmed"],
                dangerous=flags["dangerous"],
                boundary=decided[:, layout.boundary] if known else np.full(len(seeds), np.nan),
            )
            active = active.copy()
            for walker, row in counter.count(step):
                rows[walker] = {"mode": mode, "episode": walker + 1, **row}
                active[walker] = False
            observation = answer.observation
        return [row for row in rows if row is not None]

    def _init_acting(
        self, hyper: RunHyper, boundary: jax.Array, key: jax.Array, episodes: jax.Array
    ) -> ActingState:
        """An acting state for each episode, leaves [N, ...]; its key depends on nothing else."""

        def one(episode: jax.Array) -> ActingState:
            state = init_acting(self._agent, hyper, jax.random.fold_in(key, episode))
            return dataclasses.replace(state, boundary=boundary)

        return jax.vmap(one)(episodes)


def evaluate_run(evaluator: Evaluator, finished: FinishedRun, modes: Sequence[Mode]) -> list[Row]:
    """Tests a run as training left it.

    The terrain depends on the seed alone: a comparison that is paired over methods needs fewer
    episodes.

    Args:
        evaluator: plays an episode on each of its walkers.
        finished: the run.
        modes: which tests, in this order.

    Returns:
        A row for each mode and episode.
    """
    spec = finished.run.spec
    *_, key = batch.run_keys(spec.seed, method_index(spec.method))
    params = Behavior(
        actor=finished.train.learner.actor, boundary_actor=finished.train.boundary.actor
    )
    numbers = range(evaluator.num_episodes)
    seeds = np.array([episode_seed("test", spec.seed, number) for number in numbers], np.uint32)
    return [
        row
        for mode in modes
        for row in evaluator.evaluate(mode, spec.hyper, params, finished.boundary, key, seeds)
    ]


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
