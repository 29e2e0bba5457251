"""What happened at each frame of a session, as the replay holds it, and how labels change it."""

from collections.abc import Sequence

import jax
import numpy as np

from hitl_jax.arbiter import shaped_reward
from hitl_jax.config import RunHyper
from hitl_jax.envs.visible_walker import StepResult
from hitl_jax.learner.frame import GOES_ON
from hitl_jax.live.labels import Label, boundary_along, judged, unjudged
from hitl_jax.results.episode_measures import WALKER_ENDS
from hitl_jax.team.agent import Agent
from hitl_jax.training.step_booking import event_of, stored_ends

_NO_LABEL = -1
_FLAGS = (
    *("alarmed", "dangerous", "control", "human_action", "human_reset"),
    *("live", "terminated", "truncated"),
)
_MIN_COMPILED = 16
_boundary_along = jax.jit(boundary_along)


class FrameStore:
    """The last frames of a session, by number; as many as the replay holds.

    Attributes:
        count: frames so far; the number of the frame that comes next.
    """

    def __init__(self, agent: Agent, hyper: RunHyper, size: int, with_person: bool):
        """Makes an empty store.

        Args:
            agent: the team.
            hyper: the run's hyperparameters, typed host scalars.
            size: how many frames are kept.
            with_person: whether an intervention counts only while a person's label stands for it.
        """
        self._agent, self._hyper, self._with_person = agent, hyper, with_person
        self._frames = np.zeros((size, agent.layout.width), np.float32)
        self._flags = {name: np.zeros(size, bool) for name in _FLAGS}
        self._reward = np.zeros(size, np.float32)
        self._label = np.full(size, _NO_LABEL)
        self.count = 0

    @property
    def size(self) -> int:
        """How many frames are kept."""
        return len(self._reward)

    @property
    def oldest(self) -> int:
        """The first frame that is still kept when the next one has been added."""
        return max(self.count - self.size + 1, 0)

    def places(self, first: int, stop: int) -> np.ndarray:
        """Where frames [first, stop) are kept, here and in the replay."""
        return np.arange(first, stop) % self.size

    def frames(self, first: int, stop: int) -> np.ndarray:
        """Frames [first, stop), [.., W]."""
        return self._frames[self.places(first, stop)]

    def flag(self, name: str, number: int) -> bool:
        """A flag of a frame: `alarmed`, `dangerous` (by the labels of now), `control`, ..."""
        return bool(self._flags[name][number % self.size])

    def env_reward(self, number: int) -> float:
        """The environment's reward of the step from a frame; 0 where there was none."""
        return float(self._reward[number % self.size])

    def control_label(self, number: int) -> int:
        """The label by which a person had control at a frame; negative where there is none."""
        return int(self._label[number % self.size])

    def add_reset(self, observation: np.ndarray) -> None:
        """Adds a frame from which no step was taken."""
        place, layout = self.count % self.size, self._agent.layout
        self._frames[place] = 0.0
        self._frames[place, layout.observation] = observation
        self._frames[place, layout.final] = 1.0
        for values in self._flags.values():
            values[place] = False
        self._reward[place], self._label[place] = 0.0, _NO_LABEL
        self.count += 1

    def add_step(self, frame: np.ndarray, flags: dict[str, bool], result: StepResult) -> None:
        """Adds a frame from which a step was taken; `update_rewards` completes it.

        Args:
            frame: as acting packed it, [W].
            flags: of `learner.frame.Flags`, by name.
            result: of the walker.
        """
        place = self.count % self.size
        self._frames[place] = frame
        of_step = {"terminated": result.terminated, "truncated": result.truncated, "live": True}
        for name, values in self._flags.items():
            values[place] = (flags | of_step)[name]
        self._reward[place], self._label[place] = result.reward, _NO_LABEL
        self.count += 1

    def set_control_label(self, number: int, label: int) -> None:
        """Notes by which label a person had control at a frame."""
        self._label[number % self.size] = label

    def clear_control_labels(self, first: int, stop: int) -> None:
        """Notes that no person had control at frames [first, stop)."""
        self._label[self.places(first, stop)] = _NO_LABEL

    def update_rewards(self, labels: Sequence[Label], first: int, stop: int) -> None:
        """Computes the stored rewards and ends of frames [first, stop) from the labels.

        An intervention whose label was taken back costs nothing. A human reset that was taken back
        truncates, so the learner bootstraps from the next state.
        """
        layout, flags, places = self._agent.layout, self._flags, self.places(first, stop)
        stands = np.full(len(places), not self._with_person)
        if (self._label[places] != _NO_LABEL).any():
            stands = np.isin(self._label[places], [label.number for label in labels])
        control, live = flags["control"][places] & stands, flags["live"][places]
        feedback = np.float32(self._hyper.feedback)
        given = "step", control, control, control, np.float32(self._hyper.reward_weight)
        shaped = shaped_reward(self._reward[places], control, feedback, *given)
        ended, cut, reset, acted = (
            flags[name][places]
            for name in ("terminated", "truncated", "human_reset", "human_action")
        )
        reset_terminates = stands & self._agent.config.human_reset_terminates
        terminated, truncated = stored_ends(ended, cut, reset, reset_terminates)
        event = event_of(self._reward[places], ended, cut, reset, acted, WALKER_ENDS)
        self._frames[places, layout.reward] = np.where(live, shaped, 0.0)
        self._frames[places, layout.terminated] = live & terminated
        self._frames[places, layout.truncated] = live & truncated
        self._frames[places, layout.event] = np.where(live, event, GOES_ON)

    def compile(self) -> None:
        """Compiles what the first label needs, so that the person does not wait for it."""
        _boundary_along(self._hyper, np.float32(0.0), *np.zeros((3, _MIN_COMPILED), bool))

    def relabel(self, labels: Sequence[Label], first: int, boundary: np.float32) -> np.float32:
        """Computes line 8, rewards and ends again, from a frame to the last one.

        Args:
            labels: all that stand.
            first: the first frame whose judgement may have changed.
            boundary: τ of the frame that comes next, as it was.

        Returns:
            τ of the frame that comes next.
        """
        layout, stop = self._agent.layout, self.count
        places = self.places(first, stop)
        live = self._flags["live"][places]
        if not live.any():
            return boundary
        dangerous = judged(labels, first, stop) & live
        self._flags["dangerous"][places] = dangerous
        # A few sizes, since each is compiled.
        columns = np.zeros((3, max(_MIN_COMPILED, 1 << (len(places) - 1).bit_length())), bool)
        # An alarm that nobody judged is neither true nor false.
        alarmed = self._flags["alarmed"][places] & ~unjudged(labels, first, stop)
        columns[:, : len(places)] = alarmed, dangerous, live
        # A frame without a step has no boundary of its own and does not move it.
        start = self._frames[places[live.argmax()], layout.boundary]
        computed = [np.asarray(column) for column in _boundary_along(self._hyper, start, *columns)]
        names = layout.boundary, layout.next_boundary, layout.boundary_reward
        for name, values in zip(names, computed, strict=True):
            self._frames[places[live], name] = values[: len(places)][live]
        self.update_rewards(labels, first, stop)
        last = places[len(places) - 1 - live[::-1].argmax()]
        after: np.float32 = self._frames[last, layout.next_boundary]
        return after
