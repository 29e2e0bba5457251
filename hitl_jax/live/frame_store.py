"""What happened at each frame of a session, as the replay holds it, and how a label changes it."""

from collections.abc import Sequence

import jax
import numpy as np

from hitl_jax.config import RunHyper
from hitl_jax.envs.visible_walker import Answer
from hitl_jax.live.labels import Label, judged, moved, unjudged
from hitl_jax.team import arbiter
from hitl_jax.team.agent import Agent

_NOBODY = -1
_NOTED = ("alarmed", "dangerous", "control", "human_reset", "live", "terminated", "truncated")
_SHORTEST = 16
_moved = jax.jit(moved)


class Books:
    """The frames of a session, by number; as many of the last as the replay holds."""

    def __init__(self, agent: Agent, hyper: RunHyper, size: int, with_person: bool):
        """Empty books.

        Args:
            agent: the team.
            hyper: the run's hyperparameters, typed host scalars.
            size: how many frames are kept.
            with_person: whether what stands depends on a person's labels.
        """
        self._agent, self._hyper, self._with_person = agent, hyper, with_person
        self._frames = np.zeros((size, agent.layout.width), np.float32)
        self._flags = {name: np.zeros(size, bool) for name in _NOTED}
        self._reward = np.zeros(size, np.float32)
        self._label = np.full(size, _NOBODY)

    @property
    def size(self) -> int:
        """How many frames are kept."""
        return len(self._reward)

    def places(self, first: int, stop: int) -> np.ndarray:
        """Where frames [first, stop) are kept, here and in the replay."""
        return np.arange(first, stop) % self.size

    def frames(self, first: int, stop: int) -> np.ndarray:
        """Frames [first, stop), [.., W]."""
        return self._frames[self.places(first, stop)]

    def flag(self, name: str, number: int) -> bool:
        """A flag of a frame: `alarmed`, `dangerous` (as judged by now), `control`, ..."""
        return bool(self._flags[name][number % self.size])

    def label_of(self, number: int) -> int:
        """The label by which a person had control at a frame; negative where nobody had."""
        return int(self._label[number % self.size])

    def note_reset(self, number: int, observation: np.ndarray) -> None:
        """A frame from which no step was taken."""
        place, layout = number % self.size, self._agent.layout
        self._frames[place] = 0.0
        self._frames[place, layout.observation] = observation
        self._frames[place, layout.final] = 1.0
        for noted in self._flags.values():
            noted[place] = False
        self._reward[place], self._label[place] = 0.0, _NOBODY

    def note_step(
        self, number: int, frame: np.ndarray, flags: dict[str, bool], answer: Answer
    ) -> None:
        """A frame from which a step was taken.

        Args:
            number: n.
            frame: as acting packed it, [W].
            flags: of `decisions.EXTRA_COLUMNS`.
            answer: of the walker.
        """
        place = number % self.size
        self._frames[place] = frame
        told = {"terminated": answer.terminated, "truncated": answer.truncated, "live": True}
        for name, noted in self._flags.items():
            noted[place] = (flags | told)[name]
        self._reward[place], self._label[place] = answer.reward, _NOBODY

    def credit(self, number: int, label: int) -> None:
        """Says by which label a person had control at a frame."""
        self._label[number % self.size] = label

    def disown(self, first: int, stop: int) -> None:
        """Says that no person had control at frames [first, stop)."""
        self._label[self.places(first, stop)] = _NOBODY

    def settle(self, labels: Sequence[Label], first: int, stop: int) -> None:
        """Rewards and ends of frames [first, stop) as they are stored.

        An intervention that was taken back costs nothing, and where it ended the episode the
        bootstrap goes on.
        """
        layout, flags, places = self._agent.layout, self._flags, self.places(first, stop)
        stands = np.full(len(places), not self._with_person)
        if (self._label[places] != _NOBODY).any():
            stands = np.isin(self._label[places], [label.number for label in labels])
        control, live = flags["control"][places] & stands, flags["live"][places]
        feedback = np.float32(self._hyper.feedback)
        shaped = arbiter.shaped_reward(
            self._reward[places], control, feedback, "step", control, control
        )
        reset = flags["human_reset"][places]
        ends = reset & stands & self._agent.config.human_reset_terminates
        terminated = flags["terminated"][places] | ends
        truncated = (flags["truncated"][places] | reset) & ~terminated
        self._frames[places, layout.reward] = np.where(live, shaped, 0.0)
        self._frames[places, layout.terminated] = live & terminated
        self._frames[places, layout.truncated] = live & truncated

    def compile(self) -> None:
        """Compiles what the first label would else wait for."""
        _moved(self._hyper, np.float32(0.0), *np.zeros((3, _SHORTEST), bool))

    def judge_again(
        self, labels: Sequence[Label], first: int, stop: int, now: np.float32
    ) -> np.float32:
        """Line 8, rewards and ends of frames [first, stop), by the labels that there are.

        Args:
            labels: all that stand.
            first: the first frame whose judgement may have changed.
            stop: the frame that comes next.
            now: τ at `stop` as it was.

        Returns:
            τ at `stop`.
        """
        layout, places = self._agent.layout, self.places(first, stop)
        live = self._flags["live"][places]
        if not live.any():
            return now
        dangerous = judged(labels, first, stop) & live
        self._flags["dangerous"][places] = dangerous
        columns = np.zeros((3, max(_SHORTEST, 1 << (len(places) - 1).bit_length())), bool)
        # An alarm that nobody judged is neither a true one nor a false one.
        alarmed = self._flags["alarmed"][places] & ~unjudged(labels, first, stop)
        columns[:, : len(places)] = alarmed, dangerous, live
        # A frame without a step has no boundary of its own, nor moves it.
        start = self._frames[places[live.argmax()], layout.boundary]
        told = [np.asarray(column) for column in _moved(self._hyper, start, *columns)]
        names = layout.boundary, layout.next_boundary, layout.boundary_reward
        for name, values in zip(names, told, strict=True):
            self._frames[places[live], name] = values[: len(places)][live]
        self.settle(labels, first, stop)
        last = places[len(places) - 1 - live[::-1].argmax()]
        after: np.float32 = self._frames[last, layout.next_boundary]
        return after
