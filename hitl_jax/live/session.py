"""One run that a person watches and helps: a machine that time does not enter.

What a session becomes follows from its setup and from what the person does at which frame, and from
nothing else: not from the clock, the pace, or when the learner was ready. So its journal plays it
again to the last bit.

Frame n is the state s_n before the step from it. A person's label names the frame that they saw; it
changes line 8 from that frame on, and what the replay holds of it, however late it comes. What has
been played stays as it was: alarms, control, steps.
"""

import dataclasses
import zlib
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from hitl_jax.config import typed
from hitl_jax.envs.visible_walker import Answer, VisibleWalker
from hitl_jax.errors import WalkerError
from hitl_jax.learner.frame import flags_of
from hitl_jax.live import person
from hitl_jax.live.background_learner import Learning
from hitl_jax.live.frame_store import Books
from hitl_jax.live.labels import Label, judged
from hitl_jax.live.setup import Setup
from hitl_jax.results.episode_measures import Episode, Row, row_of
from hitl_jax.team.acting import ActingState, begin_episode, init_acting
from hitl_jax.training import batch_arrays
from hitl_jax.training.run_spec import episode_seed, method_index
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
        plant: the walker.
        labels: what the person said and did not take back.
        episodes: a row for each episode that has ended.
        env_steps: steps so far.
        interventions: of this episode.
        returned: return of this episode so far.
    """

    def __init__(self, setup: Setup):
        """Begins the first episode; compiles.

        Raises:
            ValueError: one line, if networks to begin with are not this team's.
        """
        agent = setup.agent
        self.setup = setup
        self.plant = VisibleWalker()
        # What was learned before need not begin with random actions.
        warmup = setup.hyper.warmup_steps if setup.start is None else 0
        self._hyper = typed(dataclasses.replace(setup.hyper, warmup_steps=warmup))
        learning, acting, _ = batch_arrays.run_keys(setup.seed, method_index(setup.method))
        train = setup.first_train(learning)
        state = init_acting(agent, self._hyper, acting)
        if setup.start is not None:
            state = dataclasses.replace(state, boundary=np.float32(setup.start["boundary"]))
        self._device = acting_device()
        self._acting: ActingState = jax.device_put(state, self._device)
        self._boundary = np.float32(state.boundary)
        self._learning = Learning(agent, self._hyper, setup.loop, train)
        self._behavior = self._learned()
        self._books = Books(agent, self._hyper, setup.loop.frames, setup.with_person)
        self._steps: list[tuple[Any, ...]] = []
        self.labels: list[Label] = []
        self._said = 0
        self._heard = False
        self._controls: int | None = None
        self._action = np.zeros(agent.layout.action_size, np.float32)
        self._assisted = False
        self.episodes: list[Row] = []
        self.env_steps = 0
        self._tick = self._step = 0
        self._new_episode()
        self._compile()

    # What the person sees.

    @property
    def frame(self) -> Frame:
        """The state that the next step begins with."""
        return Frame(
            number=self._tick,
            episode=len(self.episodes) + (not self._ended),
            step=self._step,
            observation=self._observation,
            indicator=self._indicator,
            boundary=float(self._boundary),
            alarmed=self._alarmed and not self._ended,
            ended=self._ended,
        )

    @property
    def controls(self) -> bool:
        """Whether the person has the controls."""
        return self._controls is not None

    @property
    def dangerous(self) -> bool:
        """Whether the person judges the state that comes next to be dangerous."""
        return self.controls or bool(judged(self.labels, self._tick, self._tick + 1)[0])

    @property
    def updates(self) -> int:
        """Of the task learner."""
        return self._learning.updates

    def flag(self, name: str, number: int) -> bool:
        """A flag of a frame that has been played: `alarmed`, `dangerous`, `control`."""
        return self._books.flag(name, number)

    # What the person does, before the step from the frame that comes next.

    def danger(self, down: bool, number: int) -> None:
        """Begins or ends a judgement of danger with the frame that was seen.

        Raises:
            ValueError: in one line, where there is no such frame or no person.
        """
        self._require(number)
        if not down:
            self._end("danger", number + 1)
        elif not self.dangerous:
            self._say("danger", number)
            self._heard = True  # By the arbiter, also where it ends before the next step.

    def safe(self, number: int) -> None:
        """Judges a frame safe, whatever was said of it; what goes on ends before it."""
        self.let_go(number)
        self._say("safe", number, number)

    def take(self, number: int) -> None:
        """Takes the controls, which is a judgement of danger until they are let go."""
        self._require(number)
        if self.setup.agent.config.intervention != "takeover":
            raise ValueError("taking over: this session's intervention is not a takeover")
        if not self.controls:
            self._controls = self._say("take", number)

    def let_go(self, number: int) -> None:
        """Gives the controls back; a judgement of danger that goes on ends before the frame."""
        self._require(number)
        self._heard = False
        self._end("take", number)
        self._end("danger", number)

    def move(self, action: list[float]) -> None:
        """What the person's keys ask of hips and knees from now on, [A] in [-1, 1]."""
        values = np.asarray(action, np.float64)
        if values.shape != self._action.shape or not (np.abs(values) <= 1).all():
            raise ValueError("hands: must be four numbers from -1 to 1")
        self._action = values.astype(np.float32)

    def assist(self, on: bool) -> None:
        """Whether the assistant walks while the person has the controls."""
        self._assisted = on

    def gone(self, number: int) -> None:
        """The person has gone, and saw this frame last: nobody judged the later ones.

        What was held ends with that frame. Control of later frames was nobody's: it stays as it was
        played, and costs nothing.
        """
        self._require_person()
        stop = min(number + 1, self._tick)
        self._heard = self._assisted = False
        self._action = np.zeros_like(self._action)
        self._end("take", stop)
        self._end("danger", stop)
        if stop < self._tick:
            self._books.disown(stop, self._tick)
            self._say("nobody", stop, self._tick - 1)

    def undo(self) -> Label | None:
        """Takes the last label back, with what it moved and what it cost; None if there is none."""
        label = next((said for said in reversed(self.labels) if said.kind != "nobody"), None)
        if label is None:
            return None
        taken = [label, *(said for said in self.labels if said.number == label.cause)]
        self.labels = [said for said in self.labels if said not in taken]
        self._heard = False
        if self._controls == label.number:
            self._controls = None
        self._judge_again(min(said.first for said in taken))
        return label

    # Time.

    def tick(self) -> Row | None:
        """Plays the step from the frame that comes next, or the reset after an episode.

        Returns:
            A row, if an episode ended.

        Raises:
            WalkerError: if what was learned is no longer finite; nothing can be played then.
        """
        row = None
        if self._ended:
            self._books.note_reset(self._tick, self._observation)
            self._acting = _begin(self.setup.agent, self._acting)
            self._tick += 1
            self._new_episode()
        else:
            row = self._play()
        if self._tick % self.setup.loop.chunk == 0 and self.setup.learns:
            self._end_chunk()
        return row

    def digest(self) -> str:
        """A checksum of where the session is: equal digests, equal sessions."""
        code = zlib.crc32(self._books.frames(self._oldest_of_chunk(), self._tick).tobytes())
        leaves = [self._observation, np.float32(self._boundary), *jax.tree.leaves(self._behavior)]
        for leaf in leaves:
            code = zlib.crc32(np.asarray(leaf).tobytes(), code)
        return f"{code:08x}"

    def actions(self, first: int, stop: int) -> np.ndarray:
        """The executed actions of frames [first, stop), float32 [.., A]; zeros at resets."""
        return self._books.frames(first, stop)[:, self.setup.agent.layout.action]

    def stored(self) -> tuple[np.ndarray, np.ndarray]:
        """The frames as booked, and as the learner has them, [T, W] each."""
        done = self._tick - self._tick % self.setup.loop.chunk
        first = max(self._tick - self._books.size, 0)
        places = self._books.places(first, done)
        return self._books.frames(first, done), self._learning.stored()[places]

    def networks(self) -> tuple[TrainState, np.ndarray]:
        """What was learned, and the boundary: for `checkpoint.flatten`."""
        return self._learning.train(), np.asarray(self._boundary)

    def _play(self) -> Row | None:
        number, layout = self._tick, self.setup.agent.layout
        self._acting, packed = self._act(self._acting)
        decided = np.asarray(packed)
        if not np.isfinite(decided).all():
            raise WalkerError(f"frame {number}: the learner diverged: its numbers are not finite")
        flags = {n: bool(v) for n, v in flags_of(decided, layout)._asdict().items()}
        answer = self.plant.step(decided[layout.action])
        if not (np.isfinite(answer.observation).all() and np.isfinite(answer.reward)):
            raise WalkerError(f"frame {number}: what the walker answered is not finite")
        self._books.note_step(number, decided[: layout.width], flags, answer)
        if self.setup.with_person and flags["control"]:
            flags["began"] = self._credit(number, flags["human_action"])
        self._books.settle(self.labels, number, number + 1)
        self._tick += 1
        self.env_steps += 1
        self._step += 1
        self._observation = answer.observation
        self._boundary = np.float32(decided[layout.next_boundary])
        self._ended = answer.terminated or answer.truncated or flags["human_reset"]
        row = self._count(number, flags, answer)
        if self._heard:
            self._heard = False
            self._judge_again(number)
        self._look()
        return row

    def _told(self) -> person.Told:
        return person.Told(
            dangerous=np.asarray(self.dangerous or self._heard),
            takes=np.asarray(self.controls),
            assisted=np.asarray(self._assisted),
            action=self._action,
            boundary=self._boundary,
        )

    def _credit(self, number: int, human_action: bool) -> bool:
        """Notes by which label the person has control; whether it began at this frame.

        Where the arbiter gives a person the controls, they keep them until they let go. Where it
        heard a judgement of earlier frames, that now is one of this frame as well.
        """
        label = self._controls
        if label is None:
            judging = (said for said in reversed(self.labels) if said.kind in ("danger", "take"))
            label = next(judging).number
            if human_action or not judged(self.labels, number, number + 1)[0]:
                label = self._say("take", number, None if human_action else number, cause=label)
            self._controls = label if human_action else None
        self._books.credit(number, label)
        return self._step == 0 or self._books.label_of(number) != self._books.label_of(number - 1)

    def _count(self, number: int, flags: dict[str, bool], answer: Answer) -> Row | None:
        layout = self.setup.agent.layout
        [frame] = self._books.frames(number, number + 1)
        told = {
            "reward": answer.reward,
            "shaped": frame[layout.reward],
            "terminated": answer.terminated,
            "boundary": frame[layout.boundary],
        }
        self._steps.append(tuple((flags | told)[name] for name in Episode._fields))
        self.interventions += flags["began"]
        self.returned += answer.reward
        if not self._ended:
            return None
        episode = Episode(*map(np.array, zip(*self._steps, strict=True)))
        numbers = {"episode": len(self.episodes) + 1, "env_steps": self.env_steps}
        row: Row = numbers | row_of(episode)
        self.episodes.append(row)
        return row

    def _new_episode(self) -> None:
        phase = self.setup.method if self.setup.learns else "test"
        seed = episode_seed(phase, self.setup.seed, len(self.episodes))
        self._observation = self.plant.reset(seed)
        self._step, self._ended = 0, False
        self._steps = []
        self.interventions, self.returned = 0, 0.0
        self._look()

    def _look(self) -> None:
        """What the gauge shows of the state that comes next."""
        indicator, alarmed = _see(self.setup.agent, self._observation, self._boundary)
        self._indicator = float(indicator)
        self._alarmed = bool(alarmed) and self.setup.hyper.has_arbiter > 0

    def _end_chunk(self) -> None:
        needed = max(2 * self.setup.loop.chunk, self.setup.agent.config.n_step + 2)
        warm = max(self.setup.hyper.warmup_steps, needed)
        chunk = self._books.frames(self._oldest_of_chunk(), self._tick)
        self._learning.end_chunk(chunk, self._tick >= warm)
        self._behavior = self._learned()

    def _oldest_of_chunk(self) -> int:
        return max((self._tick - 1) // self.setup.loop.chunk, 0) * self.setup.loop.chunk

    def _learned(self) -> Behavior:
        placed: Behavior = jax.device_put(self._learning.behavior, self._device)
        return placed

    # Labels.

    def _require_person(self) -> None:
        if not self.setup.with_person:
            raise ValueError("a judgement: nobody is asked in this session")

    def _require(self, number: int) -> None:
        self._require_person()
        oldest = max(self._tick - self._books.size + 1, 0)
        if not oldest <= number <= self._tick:
            raise ValueError(f"frame {number}: must be from {oldest} to {self._tick}")

    def _say(self, kind: str, first: int, last: int | None = None, cause: int | None = None) -> int:
        """Adds a label; its number."""
        label = Label(self._said, kind, first, last, cause)
        self.labels.append(label)
        self._said += 1
        self._judge_again(first)
        return label.number

    def _end(self, kind: str, stop: int) -> None:
        """Ends a label that goes on, before a frame."""
        for label in self.labels:
            if label.kind == kind and label.last is None:
                label.last = stop - 1
                if self._controls == label.number:
                    self._controls = None
                self._judge_again(stop)

    def _judge_again(self, first: int) -> None:
        first = max(first, self._tick - self._books.size + 1, 0)
        if first >= self._tick:
            return
        books = self._books
        self._boundary = books.judge_again(self.labels, first, self._tick, self._boundary)
        self._look()
        learned = self._tick - self._tick % self.setup.loop.chunk
        if self.setup.learns and first < learned:
            rows = books.frames(first, learned)[:, self.setup.agent.layout.reward :]
            self._learning.correct(books.places(first, learned), rows)

    def _compile(self) -> None:
        """Compiles what a person would else wait for in mid-play; nothing is played."""
        self._act(jax.tree.map(jnp.copy, self._acting))
        _begin(self.setup.agent, jax.tree.map(jnp.copy, self._acting))
        self._books.compile()
        if self.setup.learns:
            self._learning.compile()

    def _act(self, state: ActingState) -> tuple[ActingState, jax.Array]:
        told = self._told() if self.setup.with_person else None
        return _act(self.setup.agent, self._hyper, self._behavior, state, self._observation, told)


_act = jax.jit(person.act, static_argnums=0, donate_argnums=3)
_begin = jax.jit(begin_episode, static_argnums=0, donate_argnums=1)
_see = jax.jit(person.see, static_argnums=0)
