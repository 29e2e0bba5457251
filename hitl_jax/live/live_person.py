"""The person of a session: what they said of its frames, and what they hold now.

Each method checks the frame that the page names, changes the labels, and has the session compute
again what depends on them.
"""

from collections.abc import Callable

import numpy as np

from hitl_jax.live.frame_store import FrameStore
from hitl_jax.live.labels import Label, judged
from hitl_jax.live.person import PersonInput
from hitl_jax.live.setup import SessionSetup


class LivePerson:
    """Keeps a person's labels, control and actions.

    Attributes:
        labels: what the person said and did not take back.
    """

    def __init__(self, setup: SessionSetup, store: FrameStore, relabel: Callable[[int], None]):
        """Begins with nothing said and nothing held.

        Args:
            setup: of the session.
            store: the session's frames.
            relabel: called with the first frame whose judgement may have changed.
        """
        self._setup, self._store, self._relabel = setup, store, relabel
        self.labels: list[Label] = []
        self._num_labels = 0
        self._control_label: int | None = None
        self._danger_pending = False
        self._action = np.zeros(setup.agent.layout.action_size, np.float32)
        self._assisted = False

    @property
    def in_control(self) -> bool:
        """Whether the person has control."""
        return self._control_label is not None

    @property
    def dangerous(self) -> bool:
        """Whether the person judges the state that comes next to be dangerous."""
        return self.in_control or self._is_dangerous(self._store.count)

    # What the person does, before the step from the frame that comes next.

    def danger(self, down: bool, number: int) -> None:
        """Begins or ends a judgement of danger at the frame that the person saw.

        Raises:
            ValueError: in one line, where there is no such frame or no person.
        """
        self._require_frame(number)
        if not down:
            self._end("danger", number + 1)
        elif not self.dangerous:
            self._add("danger", number)
            self._relabel(number)
            # The arbiter must see it, even if it ends before the next step.
            self._danger_pending = True

    def safe(self, number: int) -> None:
        """Judges a frame safe, whatever was said of it; danger and control end before it."""
        self.let_go(number)
        self._add("safe", number, number)
        self._relabel(number)

    def take(self, number: int) -> None:
        """Takes control, which is a judgement of danger until the person lets go."""
        self._require_frame(number)
        if self._setup.agent.config.intervention != "takeover":
            raise ValueError("taking over: this session's intervention is not a takeover")
        if not self.in_control:
            self._control_label = self._add("take", number)
            self._relabel(number)

    def let_go(self, number: int) -> None:
        """Ends control and a judgement of danger before the frame."""
        self._require_frame(number)
        self._danger_pending = False
        self._end("take", number)
        self._end("danger", number)

    def move(self, action: list[float]) -> None:
        """Sets the person's action for hips and knees from now on, [A] in [-1, 1]."""
        values = np.asarray(action, np.float64)
        if values.shape != self._action.shape or not (np.abs(values) <= 1).all():
            raise ValueError("hands: must be four numbers from -1 to 1")
        self._action = values.astype(np.float32)

    def assist(self, on: bool) -> None:
        """Sets whether the assistant walks while the person has control."""
        self._assisted = on

    def gone(self, number: int) -> None:
        """Ends all that the person held, who saw this frame last and then went away.

        Nobody judged the later frames. Who controlled them was nobody: their actions stay as they
        were played, and cost nothing.
        """
        self._require_person()
        now = self._store.count
        stop = min(number + 1, now)
        self._danger_pending = self._assisted = False
        self._action = np.zeros_like(self._action)
        self._end("take", stop)
        self._end("danger", stop)
        if stop < now:
            self._store.clear_control_labels(stop, now)
            self._add("nobody", stop, now - 1)
            self._relabel(stop)

    def undo(self) -> Label | None:
        """Takes the last label back with all that it changed; returns it, None if there is none."""
        label = next((said for said in reversed(self.labels) if said.kind != "nobody"), None)
        if label is None:
            return None
        taken_back = [label, *(said for said in self.labels if said.number == label.cause)]
        self.labels = [said for said in self.labels if said not in taken_back]
        self._danger_pending = False
        if self._control_label == label.number:
            self._control_label = None
        self._relabel(min(said.first for said in taken_back))
        return label

    # What the session asks at each step.

    def input(self, boundary: np.float32) -> PersonInput:
        """What the person does at the next step, where the boundary is τ."""
        return PersonInput(
            dangerous=np.asarray(self.dangerous or self._danger_pending),
            in_control=np.asarray(self.in_control),
            assisted=np.asarray(self._assisted),
            action=self._action,
            boundary=boundary,
        )

    def label_control(self, number: int, human_action: bool) -> int:
        """Finds or makes the label by which the person has control at a frame; its number.

        When the arbiter gives control to a person, they keep it until they let go. When it acts on
        a judgement of earlier frames, this frame is labelled as well.

        Args:
            number: the frame that was just played.
            human_action: whether the person's action was executed there.
        """
        label = self._control_label
        if label is None:
            judging = (said for said in reversed(self.labels) if said.kind in ("danger", "take"))
            label = next(judging).number
            if human_action or not self._is_dangerous(number):
                label = self._add("take", number, None if human_action else number, cause=label)
            self._control_label = label if human_action else None
        return label

    def take_pending_danger(self) -> bool:
        """Whether the step that was just played used a new judgement of danger; once for each."""
        was_pending, self._danger_pending = self._danger_pending, False
        return was_pending

    def _is_dangerous(self, number: int) -> bool:
        return bool(judged(self.labels, number, number + 1)[0])

    def _require_person(self) -> None:
        if not self._setup.with_person:
            raise ValueError("a judgement: nobody is asked in this session")

    def _require_frame(self, number: int) -> None:
        self._require_person()
        oldest, newest = self._store.oldest, self._store.count
        if not oldest <= number <= newest:
            raise ValueError(f"frame {number}: must be from {oldest} to {newest}")

    def _add(self, kind: str, first: int, last: int | None = None, cause: int | None = None) -> int:
        """Adds a label; its number."""
        label = Label(self._num_labels, kind, first, last, cause)
        self.labels.append(label)
        self._num_labels += 1
        return label.number

    def _end(self, kind: str, stop: int) -> None:
        """Ends the labels of a kind that are still open, before a frame."""
        for label in self.labels:
            if label.kind == kind and label.last is None:
                label.last = stop - 1
                if self._control_label == label.number:
                    self._control_label = None
                self._relabel(stop)
