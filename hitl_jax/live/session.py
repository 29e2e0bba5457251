"""One run that a person watches and helps, independent of the clock.

A session follows from its setup and from what the person does at which frame: not from the time,
the pace, or when the learner was ready. So its journal plays it again to the last bit.

Frame n is the state s_n before the step from it. A person's label names the frame that they saw. It
changes line 8 from that frame on, and what the replay holds of it, however late it comes. Alarms,
control and steps stay as they were played.
"""

import dataclasses
import zlib
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from hitl_jax.config import typed
from hitl_jax.envs import StepBatch
from hitl_jax.envs.visible_walker import StepResult, VisibleWalker
from hitl_jax.errors import WalkerError
from hitl_jax.learner.frame import flags_of
from hitl_jax.live import person
from hitl_jax.live.background_learner import BackgroundLearner
from hitl_jax.live.frame_store import FrameStore
from hitl_jax.live.labels import Label
from hitl_jax.live.live_person import LivePerson
from hitl_jax.live.setup import SessionSetup
from hitl_jax.results.episode_measures import Episode, Row, row_of
from hitl_jax.team.acting import ActingState, begin_episode, init_acting
from hitl_jax.team.parts import as_tested
from hitl_jax.team.warmup import may_learn
from hitl_jax.training import batch_arrays
from hitl_jax.training.run_spec import episode_seed, method_index
from hitl_jax.training.step_booking import end_of_step, finite_decision
from hitl_jax.types import Behavior, TrainState
from hitl_jax.xla.devices import acting_device


class Frame(NamedTuple):
    """The state before a step, as a person sees it.

    Attributes:
        number: n.
        episode: counted from 1.
        step: of the episode, counted from 0.
        observation: s_n, [O].
        indicator: c_n.
        boundary: τ_n.
        alarmed: C of this state.
        ended: whether the episode is over, and a reset comes next.
    """

    number: int
    episode: int
    step: int
    observation: np.ndarray
    indicator: float
    boundary: float
    alarmed: bool
    ended: bool


class Session:
    """Plays one run step by step.

    Attributes:
        setup: what it began with.
        walker: the walker.
        person: what the person said and holds, and how they say it.
        episodes: a row for each episode that has ended.
        env_steps: steps so far.
        interventions: of this episode.
        returned: return of this episode so far.
    """

    def __init__(self, setup: SessionSetup):
        """Begins the first episode; compiles.

        Raises:
            ValueError: one line, if networks to begin with are not this team's.
        """
        agent = setup.agent
        self.setup = setup
        self.walker = VisibleWalker()
        # Networks that were learned before act from the first step, without random actions.
        warmup = setup.hyper.warmup_steps if setup.start is None else 0
        hyper = setup.agent.with_extra(setup.hyper)
        self._hyper = typed(dataclasses.replace(hyper, warmup_steps=warmup))
        learning, acting, _ = batch_arrays.run_keys(setup.seed, method_index(setup.method))
        train = setup.first_train(learning)
        state = init_acting(agent, self._hyper, acting)
        if setup.start is not None:
            state = dataclasses.replace(state, boundary=np.float32(setup.start["boundary"]))
        self._device = acting_device()
        self._acting: ActingState = jax.device_put(state, self._device)
        self._boundary = np.float32(state.boundary)
        self._learner = BackgroundLearner(agent, self._hyper, setup.loop, train)
        self._behavior = self._current_behavior()
        self._store = FrameStore(agent, self._hyper, setup.loop.frames, setup.with_person)
        self.person = LivePerson(setup, self._store, self._relabel)
        self._steps: list[tuple[Any, ...]] = []
        self.episodes: list[Row] = []
        self.env_steps = self._step = 0
        self._begin_episode()
        self._compile()

    @property
    def frame(self) -> Frame:
        """The state that the next step begins with."""
        return Frame(
            number=self._store.count,
            episode=len(self.episodes) + (not self._ended),
            step=self._step,
            observation=self._observation,
            indicator=self._indicator,
            boundary=float(self._boundary),
            alarmed=self._alarmed and not self._ended,
            ended=self._ended,
        )

    @property
    def labels(self) -> list[Label]:
        """What the person said and did not take back."""
        return self.person.labels

    @property
    def updates(self) -> int:
        """Of the task learner."""
        return self._learner.updates

    def flag(self, name: str, number: int) -> bool:
        """A flag of a frame that has been played: `alarmed`, `dangerous`, `control`, ..."""
        return self._store.flag(name, number)

    def env_reward(self, number: int) -> float:
        """The environment's reward of the step from a frame that has been played."""
        return self._store.env_reward(number)

    def frames(self, first: int, stop: int) -> np.ndarray:
        """Frames [first, stop) as the replay holds them, [.., W]."""
        return self._store.frames(first, stop)

    def actions(self, first: int, stop: int) -> np.ndarray:
        """The executed actions of frames [first, stop), float32 [.., A]; zeros at resets."""
        return self.frames(first, stop)[:, self.setup.agent.layout.action]

    def stored(self) -> tuple[np.ndarray, np.ndarray]:
        """The frames of finished chunks, here and as the learner has them, [T, W] each."""
        count = self._store.count
        done = count - count % self.setup.loop.chunk
        first = max(count - self._store.size, 0)
        places = self._store.places(first, done)
        return self.frames(first, done), self._learner.stored()[places]

    def networks(self) -> tuple[TrainState, np.ndarray]:
        """What was learned, and the boundary: for `checkpoint.flatten`."""
        return as_tested(self._learner.train()), np.asarray(self._boundary)

    def digest(self) -> str:
        """A checksum of the session's state: equal digests, equal sessions."""
        code = zlib.crc32(self._last_chunk().tobytes())
        leaves = [self._observation, np.float32(self._boundary), *jax.tree.leaves(self._behavior)]
        for leaf in leaves:
            code = zlib.crc32(np.asarray(leaf).tobytes(), code)
        return f"{code:08x}"

    def tick(self) -> Row | None:
        """Plays the step from the frame that comes next, or the reset after an episode.

        Returns:
            A row, if an episode ended.

        Raises:
            WalkerError: if the learner's or the walker's numbers are not finite; the session cannot
                go on.
        """
        row = None
        if self._ended:
            self._store.add_reset(self._observation)
            self._acting = _begin(self.setup.agent, self._acting)
            self._begin_episode()
        else:
            row = self._play()
        if self._store.count % self.setup.loop.chunk == 0 and self.setup.learns:
            self._end_chunk()
        return row

    def _play(self) -> Row | None:
        """Plays a step; a row, if an episode ended with it."""
        number, layout = self._store.count, self.setup.agent.layout
        self._acting, packed = self._act(self._acting)
        decided = np.asarray(packed)
        rows = decided[None]
        if not all(finite.all() for finite in finite_decision(rows, layout).values()):
            raise WalkerError(f"frame {number}: the learner diverged: its numbers are not finite")
        flags = {n: bool(v) for n, v in flags_of(decided, layout)._asdict().items()}
        result = self.walker.step(decided[layout.action])
        ended = self._ends(rows, result)
        self._store.add_step(decided[: layout.width], flags, result)
        if self.setup.with_person and flags["control"]:
            flags["began"] = self._label_control(number, flags["human_action"])
        self._store.update_rewards(self.labels, number, number + 1)
        self.env_steps += 1
        self._step += 1
        self._observation = result.observation
        self._boundary = np.float32(decided[layout.next_boundary])
        self._ended = ended
        row = self._count_step(number, flags, result)
        if self.person.take_pending_danger():
            # The arbiter used a judgement that may be of earlier frames alone.
            self._relabel(number)
        self._update_alarm()
        return row

    def _ends(self, rows: np.ndarray, result: StepResult) -> bool:
        """Whether a step that was just played ended the episode; see `end_of_step`.

        Raises:
            WalkerError: if what the walker answered is not finite.
        """
        values = result.observation, result.reward, result.terminated, result.truncated
        answer = StepBatch(*(np.asarray(value)[None] for value in values))
        live = np.ones(1, bool)
        end = end_of_step(rows, answer, self.setup.agent.layout, live, ~live)
        if not end.sound.all():
            number = self._store.count
            raise WalkerError(f"frame {number}: what the walker answered is not finite")
        return bool(end.ended[0])

    def _label_control(self, number: int, human_action: bool) -> bool:
        """Notes by which label the person has control; whether it began at this frame."""
        store, label = self._store, self.person.label_control(number, human_action)
        store.set_control_label(number, label)
        return self._step == 0 or label != store.control_label(number - 1)

    def _count_step(self, number: int, flags: dict[str, bool], result: StepResult) -> Row | None:
        """Adds a step to its episode; a row, if that has ended."""
        layout = self.setup.agent.layout
        [frame] = self.frames(number, number + 1)
        measured = {
            "reward": result.reward,
            "shaped": frame[layout.reward] + 0.0,  # −0 is written as 0.
            "terminated": result.terminated,
            "boundary": frame[layout.boundary],
        }
        self._steps.append(tuple((flags | measured)[name] for name in Episode._fields))
        self.interventions += flags["began"]
        self.returned += result.reward
        if not self._ended:
            return None
        episode = Episode(*map(np.array, zip(*self._steps, strict=True)))
        numbers = {"episode": len(self.episodes) + 1, "env_steps": self.env_steps}
        row: Row = numbers | row_of(episode)
        self.episodes.append(row)
        return row

    def _begin_episode(self) -> None:
        phase = self.setup.method if self.setup.learns else "test"
        seed = episode_seed(phase, self.setup.seed, len(self.episodes))
        self._observation = self.walker.reset(seed)
        self._step, self._ended = 0, False
        self._steps = []
        self.interventions, self.returned = 0, 0.0
        self._update_alarm()

    def _update_alarm(self) -> None:
        """Computes indicator and alarm of the state that comes next."""
        agent = self.setup.agent
        indicator, alarmed = _see(agent, self._behavior, self._observation, self._boundary)
        self._indicator = float(indicator)
        self._alarmed = bool(alarmed) and self.setup.hyper.has_arbiter > 0

    def _end_chunk(self) -> None:
        """Hands the chunk to the learner, and takes its next parameters."""
        setup, count = self.setup, self._store.count
        warm = may_learn(setup.hyper, count, setup.loop.chunk, setup.agent.config.n_step)
        self._learner.add_chunk(self._last_chunk(), warm)
        self._behavior = self._current_behavior()
        self._update_alarm()

    def _last_chunk(self) -> np.ndarray:
        """The frames so far of the chunk that the last frame belongs to, [.., W]."""
        count, chunk = self._store.count, self.setup.loop.chunk
        return self.frames(max((count - 1) // chunk, 0) * chunk, count)

    def _current_behavior(self) -> Behavior:
        placed: Behavior = jax.device_put(self._learner.behavior, self._device)
        return placed

    def _relabel(self, first: int) -> None:
        """Computes again what depends on the labels, here and in the replay, from a frame on."""
        store, count = self._store, self._store.count
        first = max(first, store.oldest)
        if first >= count:
            return
        self._boundary = store.relabel(self.labels, first, self._boundary)
        self._update_alarm()
        learned = count - count % self.setup.loop.chunk
        if self.setup.learns and first < learned:
            rows = store.frames(first, learned)[:, self.setup.agent.layout.reward :]
            self._learner.overwrite(store.places(first, learned), rows)

    def _compile(self) -> None:
        """Compiles all programs, so that a person does not wait for them later."""
        self._act(jax.tree.map(jnp.copy, self._acting))
        _begin(self.setup.agent, jax.tree.map(jnp.copy, self._acting))
        self._store.compile()
        if self.setup.learns:
            self._learner.compile()

    def _act(self, state: ActingState) -> tuple[ActingState, jax.Array]:
        said = self.person.input(self._boundary) if self.setup.with_person else None
        return _act(self.setup.agent, self._hyper, self._behavior, state, self._observation, said)


_act = jax.jit(person.act, static_argnums=0, donate_argnums=3)
_begin = jax.jit(begin_episode, static_argnums=0, donate_argnums=1)
_see = jax.jit(person.indicator_and_alarm, static_argnums=0)
