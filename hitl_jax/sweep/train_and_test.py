"""Trains runs and tests each at its end: what a sweep and an ablation have in common."""

import hashlib
import itertools
import pathlib
import time
from collections.abc import Callable, Generator, Sequence
from typing import Any, NamedTuple

from hitl_jax.config import AgentConfig, Method
from hitl_jax.envs import WALKER, WalkerPool, make_pool
from hitl_jax.errors import InvalidValue
from hitl_jax.evaluation.examiners import make_examiner, num_test_walkers
from hitl_jax.evaluation.trials import Mode, evaluate_runs
from hitl_jax.human import actions
from hitl_jax.human.judgement import HumanPart
from hitl_jax.learner.networks import Actor
from hitl_jax.results.episode_measures import Row
from hitl_jax.results.provenance import git_commit, processor, versions
from hitl_jax.results.run_key import RunKey
from hitl_jax.sweep.signals import deferred_interrupts
from hitl_jax.team import checkpoint
from hitl_jax.team.agent import Agent, make_agent
from hitl_jax.training.rollout import Rollout
from hitl_jax.training.run_spec import FinishedRun, LoopConfig, RunSpec, episode_seed, num_slots
from hitl_jax.training.saved_run import SavedRun
from hitl_jax.xla.cores import num_cores


class Walkers(NamedTuple):
    """What walkers a batch plays and tests on.

    Attributes:
        backend: one of `hitl_jax.envs.BACKENDS`.
        slots: runs at a time, at most.
        workers: processes that step walkers; None is one a core.
        test_episodes: of one test.
        env: the task, see `hitl_jax.tasks.task_of`.
    """

    backend: str
    slots: int
    workers: int | None
    test_episodes: int
    env: str = WALKER


def make_team(
    config: AgentConfig,
    human_policy: str | None,
    judge: HumanPart | None = None,
    source: actions.ActionSource | None = None,
) -> Agent:
    """The team that the options describe.

    Args:
        config: static choices.
        human_policy: a `params.npz` whose actor gives the human's actions; None: as
            `human_actions` says.
        judge: a human of one's own; None is the simulated one.
        source: their hands, where no file gives the actions; None: as `human_actions` says.

    Raises:
        ValueError: one line, if the file is no checkpoint of such a walker.
    """
    if human_policy is not None:
        actor = checkpoint.load_actor(human_policy, config.observation_size, config.action_size)
        *hidden, size = checkpoint.hidden_sizes(actor)
        source = actions.policy(Actor(tuple(hidden), size).apply, actor)
    return make_agent(config, judge=judge, source=source)


def policy_digest(policy: str | None, name: str = "human_policy") -> str | None:
    """What a `params.npz` holds, for a record of what defines the numbers: not where it lies.

    Args:
        policy: the file, or None.
        name: of the value that names it.

    Raises:
        InvalidValue: one line, if it cannot be read.
    """
    if policy is None:
        return None
    try:
        held = pathlib.Path(policy).read_bytes()
    except OSError as error:
        raise InvalidValue(name, policy, str(error.strerror)) from error
    return "sha256:" + hashlib.sha256(held).hexdigest()


class Batch(NamedTuple):
    """Runs that one compiled program trains side by side.

    Attributes:
        name: of the batch among others of one command; its saves are kept by it.
        agent: the team.
        specs: the runs.
        loop: how much they play and learn.
        walkers: the walkers.
    """

    name: str
    agent: Agent
    specs: Sequence[RunSpec]
    loop: LoopConfig
    walkers: Walkers

    @property
    def slots(self) -> int:
        """Runs at a time, on this machine."""
        return num_slots(len(self.specs), self.walkers.slots)


class Tested(NamedTuple):
    """A run that has ended, and where and how it was made.

    Attributes:
        finished: the run.
        tests: rows of its tests at the end.
        progress: rows of its tests at snapshots.
        wall_seconds: from its first step to the end of its tests [s].
        machine: processor and number of its cores.
        versions: of what its numbers depend on.
        commit: of the code.
    """

    finished: FinishedRun
    tests: list[Row]
    progress: list[Row]
    wall_seconds: float
    machine: str
    versions: dict[str, Any]
    commit: str

    @property
    def key(self) -> RunKey:
        """The run's name."""
        return self.finished.run.spec.key


def train_and_test(
    batch: Batch,
    watch: Callable[[Rollout], None],
    saved: dict[RunKey, SavedRun] | None = None,
) -> Generator[Tested]:
    """Gives each run as it ends, tested.

    Args:
        batch: the runs.
        watch: called after each chunk.
        saved: runs to go on with, see `Rollout`; None also says that `watch` saves none.

    Raises:
        Interrupted: after Ctrl-C or SIGTERM, when the chunk, or the step of a test, under way has
            ended; the rollout that `watch` has seen can be saved.
        KeyboardInterrupt: after a second Ctrl-C, at once.
    """
    _, agent, specs, loop, walkers = batch
    machine, commit = f"{processor()}, {num_cores()} cores", git_commit() or "unknown"
    made_with = versions()
    cores = walkers.workers or num_cores()
    test_walkers = num_test_walkers(walkers.backend, walkers.test_episodes, len(specs), cores)

    def pool_of(phase: str, count: int) -> WalkerPool:
        # For EnvPool, whose walkers cannot be seeded one by one: other runs, other seed.
        runs = (f"{spec.method}-{spec.seed}" for spec in specs)
        begun = sum(run.facts["ticks"] for run in (saved or {}).values())
        seed = episode_seed(phase, *runs, begun) >> 1
        return make_pool(walkers.backend, count, walkers.workers, walkers.env, seed=seed)

    with pool_of("train", batch.slots) as pool, pool_of("test", test_walkers) as test_pool:
        examiner = make_examiner(agent, test_pool, walkers.test_episodes)
        rollout = Rollout(agent, specs, pool, loop, saved=saved)
        chunks = iter(rollout)
        first = next(chunks)  # Compiles; nothing is lost if it is interrupted.
        with deferred_interrupts() as interrupted:

            def between() -> None:
                watch(rollout)
                interrupted()

            untested: list[FinishedRun] = []
            for done in itertools.chain([first], chunks):
                untested += done
                rollout.hold(done)
                most = examiner.num_runs
                while len(untested) >= most or (untested and rollout.waits()):
                    some, untested = untested[:most], untested[most:]
                    told = evaluate_runs(examiner, some, _modes, between)
                    for finished, (tests, progress) in zip(some, told, strict=True):
                        took = time.monotonic() - finished.run.started
                        yield Tested(finished, tests, progress, took, machine, made_with, commit)
                    rollout.release(some)
                between()


def _modes(method: Method) -> tuple[Mode, ...]:
    if method is Method.SRL:
        return ("autonomous",)  # without an arbiter nobody can be asked
    return ("autonomous", "assisted")
