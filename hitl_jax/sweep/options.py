"""The options of a sweep, with units and defaults."""

import dataclasses
import itertools
import os
from collections.abc import Sequence
from typing import Annotated

import numpy as np
import tyro

from hitl_jax.boundary import BOUNDARY_LEARNERS
from hitl_jax.choices.checks import (
    one_of,
    require,
    require_default,
    require_seeds,
    require_whole,
)
from hitl_jax.choices.fields import choice, choices, described
from hitl_jax.choices.registry import is_imported
from hitl_jax.config import LAST, AgentConfig, Hyper, Method, hyper_for, validate_hyper
from hitl_jax.envs import BACKENDS, OUR_WALKERS, WALKER
from hitl_jax.errors import InvalidValue
from hitl_jax.evaluation.trials import MOST_TEST_EPISODES, milestones
from hitl_jax.learner.frame import Layout
from hitl_jax.sweep import fitted_human, recorded_human, shards
from hitl_jax.sweep.autosave import SAVE_SECONDS
from hitl_jax.sweep.changes import Parts, of_task
from hitl_jax.sweep.launchers import LaunchOptions
from hitl_jax.sweep.logs.run_log import LOGS, require_log
from hitl_jax.sweep.presets import AS_PRESET, FULL, HUMAN_PRESETS, PRESETS, Preset
from hitl_jax.sweep.shards import Shard
from hitl_jax.tasks import TASKS, task_of
from hitl_jax.training.run_spec import LoopConfig, RunSpec, num_slots

_MOST_WORKERS = 1024
_JUDGES = {
    recorded_human.PREFIX: "whose judgements are played back",
    fitted_human.PREFIX: "who judges as they were fitted to",
}
_OURS_ALONE = ("lean", "jax")


@described
@dataclasses.dataclass(frozen=True)
class SweepOptions:
    """Train SRL, HITL-FIX and HITL-AC over a batch of seeds, test each walker, draw Figures 4-7.

    Attributes:
        preset: `full` is the default comparison (10 seeds, 400 episodes, 100 test episodes);
            `quick` is for looking around (2 seeds, 100 episodes, 20 test episodes, a few minutes);
            `paper` has 10 seeds, 1000 episodes and 100 test episodes, and what section IV of the
            paper says, whatever the other defaults are: its kind of learner (`ddpg`), a human who
            judges the angle at once and resets the walker, a boundary that line 8 moves,
            action noise that stays, tests of the last parameters.
        human_preset: the simulated human, with hands and feedback: `person` reacts after 0.2 s,
            foresees falls and takes over; `ideal` judges the angle at once and resets the walker;
            `preset` is `ideal` with the preset `paper`, else `person`.
        methods: which of srl, hitl-fix, hitl-ac to run.
        seeds: number of seeds for each method (default: the preset's).
        first_seed: the first of them; the others follow.
        episodes: training episodes of a run (default: the preset's).
        test_episodes: test episodes of a run, alone and again with the human (default: the
            preset's).
        env: the task; or gymnasium's name of another environment with flat observations and bounded
            continuous actions (`module:Name-v0` if a module registers it), for which indicator,
            danger and human_actions must be named:
        backend: what plays the walkers (default: lean, or jax where Box2D cannot be imported; for
            another task than a BipedalWalker gymnasium):
        workers: processes that step walkers, or CPU devices with `jax` (default: one a core).
        slots: runs at a time, at least two a core; the others wait. Each takes capacity x 148 bytes
            of memory.
        human: `simulated`, by the options below; `recorded:FILE`, a person's judgements in a live
            session (see `hitl-jax recorded`), played back step by step; or `fitted:FILE`, who was
            fitted to what a person did (see `hitl-jax import`).
        human_policy: a `params.npz` whose actor gives the human's actions (default: as
            `human_actions` says).
        log: logs of all runs in other tools' formats, written as they go on:
        save_seconds: how often runs under way are saved [s]: what a killed process loses at most.
        out: folder of the results. An interrupted sweep goes on in the same folder.
        shard: of a sweep in parts, which to make: `3/16` is the third of sixteen. Each has a folder
            of its own; `hitl-jax merge` makes one of them.
        launch: where runs are made.
        agent: static choices.
        loop: how much a run plays and learns.
        hyper: numbers that can differ from run to run.
    """

    preset: str = FULL
    human_preset: str = AS_PRESET
    methods: tuple[str, ...] = tuple(Method)
    seeds: int | None = None
    first_seed: int = 0
    episodes: int | None = None
    test_episodes: int | None = None
    env: str = choice(WALKER, TASKS)
    backend: str | None = choice(None, BACKENDS)
    workers: int | None = None
    slots: int = 32
    human: str = recorded_human.SIMULATED
    human_policy: str | None = None
    log: tuple[str, ...] = choices((), LOGS)
    save_seconds: float = SAVE_SECONDS
    out: str = "runs/sweep"
    shard: str | None = None
    launch: Annotated[LaunchOptions, tyro.conf.arg(name="")] = LaunchOptions()
    agent: Annotated[AgentConfig, tyro.conf.arg(name="")] = AgentConfig()
    loop: Annotated[LoopConfig, tyro.conf.arg(name="")] = LoopConfig()
    hyper: Annotated[Hyper, tyro.conf.arg(name="")] = Hyper()

    @classmethod
    def of_preset(
        cls, preset: str, human_preset: str = AS_PRESET, env: str = WALKER
    ) -> "SweepOptions":
        """The options where only presets and task are given: their changes in the defaults' place.

        Args:
            preset: one of `PRESETS`.
            human_preset: one of `HUMAN_PRESETS`.
            env: see `task_of`.

        Raises:
            ValueError: one line, if the task cannot be had, or changes what is no option.
        """
        parts = of_task(env, PRESETS[preset].changes | HUMAN_PRESETS[human_preset])
        return cls(
            preset,
            human_preset,
            env=env,
            human_policy=parts.human_policy,
            agent=parts.agent,
            loop=parts.loop,
            hyper=parts.hyper,
        )

    @classmethod
    def defaults(cls, words: Sequence[str]) -> "SweepOptions":
        """What is not given on a command line: of presets and task that it names, the last of each.

        Raises:
            ValueError: as `of_preset`.
        """
        preset = _last_given("preset", words, cls().preset)
        human = _last_given("human-preset", words, AS_PRESET)
        known = preset in PRESETS and human in HUMAN_PRESETS
        return cls.of_preset(preset, human, _last_given("env", words, WALKER)) if known else cls()

    def scale(self) -> Preset:
        """The preset, with what the task and the options say in place of it."""
        names = ("seeds", "episodes", "test_episodes")
        preset, episodes = PRESETS[self.preset], task_of(self.env).episodes
        if episodes is not None and self.preset == FULL:
            preset = dataclasses.replace(preset, episodes=episodes)
        given = {name: getattr(self, name) for name in names if getattr(self, name) is not None}
        return dataclasses.replace(preset, **given)

    def specs(self) -> list[RunSpec]:
        """The runs, seed after seed: what there is at any time is a fair comparison."""
        scale = self.scale()
        snapshots = milestones(scale.episodes)
        specs = [
            RunSpec(method, seed, hyper_for(method, self.hyper), scale.episodes, snapshots)
            for seed in range(self.first_seed, self.first_seed + scale.seeds)
            for method in map(Method, self.methods)
        ]
        part = self.part()
        return specs if part is None else part.part(specs)

    def part(self) -> Shard | None:
        """The shard that is asked for; None for all of the sweep."""
        if self.shard is None:
            return None
        number, of = shards.parse(self.shard)
        return Shard(number, of, list(self.methods), self.first_seed, self.scale().seeds)

    def checked(self) -> "SweepOptions":
        """Checks everything that can be checked before work starts; returns itself.

        Raises:
            InvalidValue: one line with the name, the value and what is allowed.
        """
        one_of("preset", self.preset, tuple(PRESETS))
        one_of("human_preset", self.human_preset, tuple(HUMAN_PRESETS))
        played = task_of(self.env).env_id
        if self.backend is not None:
            BACKENDS.check(self.backend)
            if self.backend in _OURS_ALONE and played not in OUR_WALKERS:
                why = f"plays {' and '.join(OUR_WALKERS)} alone: must be gymnasium with env "
                why += self.env
                raise InvalidValue("backend", self.backend, why, mentions=("env",))
        known = list(Method)
        if not self.methods or any(method not in known for method in self.methods):
            given = " ".join(self.methods) or "(none)"
            raise InvalidValue("methods", given, f"must be some of {', '.join(known)}")
        if len(set(self.methods)) < len(self.methods):
            raise InvalidValue("methods", " ".join(self.methods), "each at most once")
        scale = self.scale()
        require_seeds(self.first_seed, scale.seeds)
        require_whole("episodes", scale.episodes, at_least=1)
        require_whole("test_episodes", scale.test_episodes, 1, MOST_TEST_EPISODES)
        require_whole("slots", self.slots, at_least=1)
        if self.workers is not None:
            require_whole("workers", self.workers, 1, _MOST_WORKERS)
        if len(set(self.log)) < len(self.log):
            raise InvalidValue("log", " ".join(self.log), "each at most once")
        for name in self.log:
            require_log(name)
        require("save_seconds", self.save_seconds, at_least=0.0)
        self.launch.checked()
        if not self.specs():
            runs = len(self.methods) * scale.seeds
            raise InvalidValue("shard", self.shard, f"has none of the {runs} runs")
        validate_hyper(self.hyper)
        usual = self.of_preset(self.preset, self.human_preset, self.env)
        require_hands(self.agent, usual.agent, self.human_policy)
        require_meaning(self.agent, self.hyper)
        if self.hyper.reward_weight == 0.0 and Method.SRL in self.methods:
            why = "leaves srl nothing to learn from: name other methods"
            raise InvalidValue("reward_weight", 0, why, mentions=("methods",))
        if self.human != recorded_human.SIMULATED:
            is_fitted = self.human.startswith(fitted_human.PREFIX)
            kind = fitted_human.PREFIX if is_fitted else recorded_human.PREFIX
            why = f"has no meaning beside human {kind}FILE, {_JUDGES[kind]}"
            if self.human_preset != AS_PRESET:
                raise InvalidValue("human_preset", self.human_preset, why, mentions=("human",))
            require_no_simulated_judge(
                Parts(self.agent, self.loop, self.hyper, self.human_policy),
                Parts(usual.agent, usual.loop, usual.hyper, usual.human_policy),
                why,
                mentions=("human",),
            )
        own = is_imported(self.backend) or played not in OUR_WALKERS
        require_team(self.agent, self.loop, own)
        if self.launch.launcher == "local":
            require_room(self.agent, self.loop, num_slots(len(self.specs()), self.slots))
        return self


def _last_given(option: str, words: Sequence[str], given: str) -> str:
    """The value of an option on a command line, the last if there are several; else as given."""
    for word, following in itertools.pairwise([*words, ""]):
        name, sign, value = word.partition("=")
        if name.replace("_", "-") == f"--{option}":
            given = value if sign else following
    return given


def require_hands(agent: AgentConfig, usual: AgentConfig, human_policy: str | None) -> None:
    """Refuses two sources of the human's actions.

    Args:
        agent: the team.
        usual: the team where no option is given.
        human_policy: the file of the other source.

    Raises:
        InvalidValue: one line with the name and why.
    """
    if human_policy is not None:
        why = "has no meaning beside human_policy, whose actions the human takes"
        require_default(agent, usual, ("human_actions",), why, mentions=("human_policy",))


def require_meaning(agent: AgentConfig, hyper: Hyper) -> None:
    """Refuses a noise to fade to where it does not fade, and the step of an average not tested.

    Args:
        agent: the team.
        hyper: the run's numbers.

    Raises:
        InvalidValue: one line with the name and why.
    """
    if hyper.noise_steps == 0 and hyper.final_noise:
        why = "has no meaning beside noise_steps 0, with which the noise does not fade"
        raise InvalidValue("final_noise", hyper.final_noise, why, mentions=("noise_steps",))
    if agent.tested_actor == LAST and hyper.average_step_size != Hyper().average_step_size:
        why = f"has no meaning beside tested_actor {LAST}"
        raise InvalidValue("average_step_size", hyper.average_step_size, why, ("tested_actor",))


def require_no_simulated_judge(
    given: Parts, usual: Parts, why: str, mentions: tuple[str, ...]
) -> None:
    """Refuses options of the simulated human's judgement, where somebody else judges.

    Args:
        given: the team and its numbers.
        usual: the same where no option is given.
        why: the options have no meaning.
        mentions: names of other values that stand in `why`.

    Raises:
        InvalidValue: one line with the name and why.
    """
    require_default(given.agent, usual.agent, ("danger", "human_parts"), why, mentions=mentions)
    human = given.hyper.human
    numbers = [field.name for field in dataclasses.fields(human)]
    require_default(human, usual.hyper.human, numbers, why, "human.", mentions)


def require_room(agent: AgentConfig, loop: LoopConfig, slots: int) -> None:
    """Refuses replays that cannot be: the system would kill the process for them.

    Args:
        agent: the team.
        loop: of its runs.
        slots: runs at a time.

    Raises:
        InvalidValue: one line with the name, the value and what is allowed.
    """
    has = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    frame = Layout(agent.observation_size, agent.action_size).width * np.float32().nbytes
    if slots * loop.frames * frame > has:
        raise InvalidValue(
            "capacity",
            loop.capacity,
            f"must be at most {has // (slots * frame)}: the replays of {slots} runs at a time "
            f"would take {slots * loop.frames * frame / 1e9:.0f} GB, and this machine has "
            f"{has / 1e9:.0f}",
        )


def require_team(agent: AgentConfig, loop: LoopConfig, own: bool = False) -> None:
    """Checks that a team fits the walker and its loop.

    Args:
        agent: the team.
        loop: of its runs.
        own: whether the environment is none of ours: `with_backend` compares its sizes.

    Raises:
        InvalidValue: one line with the name, the value and what is allowed.
    """
    for name in () if own else ("observation_size", "action_size"):
        has = getattr(AgentConfig(), name)
        require(name, getattr(agent, name), at_least=has, at_most=has)
    loop.require_n_step(agent.n_step)
    learner = BOUNDARY_LEARNERS.make(agent.boundary_learner, agent)
    loop.require_frames(learner.least_frames, agent.boundary_learner)
    loop.num_updates(agent.task_learner.policy_delay)
