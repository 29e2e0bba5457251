"""A finished run to call: `load_run("results/full/runs/hitl-ac/seed-0003")`."""

import os
import pathlib

import jax
import jax.numpy as jnp
import numpy as np

from hitl_jax.config import typed
from hitl_jax.errors import ResultsError
from hitl_jax.evaluation.trials import as_tested, frozen, init_test
from hitl_jax.playback.load_trained import agent_of, load_trained
from hitl_jax.results.folder import ResultsFolder
from hitl_jax.results.run_key import RunKey
from hitl_jax.team.acting import Decision, act
from hitl_jax.team.agent import Agent
from hitl_jax.training.run_spec import RunSpec, Snapshot


class TrainedRun:
    """A run as its tests find it: the walker alone, without action noise.

    Call it with an observation, or with several, for the walker's actions.

    Attributes:
        spec: which run.
        agent: the team.
    """

    def __init__(self, agent: Agent, spec: RunSpec, end: Snapshot):
        """Compiles at the first call.

        Args:
            agent: the team.
            spec: which run.
            end: what acts at its end.
        """
        self.agent, self.spec = as_tested(agent), spec
        hyper = typed(frozen(spec.hyper, human_present=False))
        self._size = agent.config.observation_size

        boundary, key = jnp.asarray(end.boundary), jax.random.key(0)

        @jax.jit
        def decide(observations: jax.Array) -> Decision:
            state = init_test(self.agent, hyper, boundary, key, jnp.zeros((), jnp.int32))
            one = lambda seen: act(self.agent, hyper, end.behavior, state, seen)[1]  # noqa: E731
            decided: Decision = jax.vmap(one)(observations)
            return decided

        self._decide = decide

    def __call__(self, observation: np.ndarray) -> np.ndarray:
        """The walker's actions.

        Args:
            observation: s_t, [O] or [N, O].

        Returns:
            Actions in [-1, 1], float32 [A] or [N, A]; where an environment has other bounds, scale
            them onto these.

        Raises:
            ValueError: for observations of another shape.
        """
        return np.asarray(self.decide(observation).action)

    def decide(self, observation: np.ndarray) -> Decision:
        """All that is decided in a state: action, boundary τ_t, alarm, and the human's judgement.

        The human sees the state as the first of an episode; one who reacts late sees no danger yet.

        Args:
            observation: s_t, [O] or [N, O].

        Returns:
            The decision, leaves [...] or [N, ...].

        Raises:
            ValueError: for observations of another shape.
        """
        seen = np.asarray(observation, np.float32)
        if seen.ndim not in (1, 2) or seen.shape[-1] != self._size:
            size = self._size
            raise ValueError(f"observation {seen.shape}: must be [{size}] or [N, {size}]")
        # An axis of one alone makes another program, which rounds otherwise.
        rows = np.atleast_2d(seen)
        whole = np.concatenate([rows, rows[:1]]) if len(rows) == 1 else rows
        decided = jax.tree.map(lambda leaf: leaf[: len(rows)], self._decide(whole))
        one: Decision = jax.tree.map(lambda leaf: leaf[0], decided) if seen.ndim == 1 else decided
        return one


def load_run(path: str | os.PathLike[str]) -> TrainedRun:
    """A finished run of a results folder.

    Args:
        path: of the run, `RESULTS/runs/METHOD/seed-NNNN`.

    Raises:
        ResultsError: one line, if it is no such run, is damaged, or names code that is not trusted.
    """
    run = pathlib.Path(path).resolve()
    method, seed = run.parent.name, run.name.removeprefix("seed-")
    if len(run.parts) < 4 or run.parents[1].name != "runs" or not seed.isdecimal():
        raise ResultsError(f"{path}: must be a run's folder, RESULTS/runs/METHOD/seed-NNNN")
    folder = ResultsFolder(run.parents[2])
    agent, key = agent_of(folder), RunKey(method, int(seed))
    if folder.load_run(key).diverged:
        raise ResultsError(f"{path}: diverged in training; there is nothing to call")
    return TrainedRun(agent, *load_trained(agent, folder, key))
