"""Counts what happens in the episodes of N walkers, for training and test alike (host, NumPy)."""

from typing import Any, NamedTuple

import numpy as np

ALARM_WINDOW = 50
"""k of "falls within k steps": alarms count as timely in the last second before a fall."""

FALL_REWARD = -100.0
"""BipedalWalker's reward for the step in which it falls; another terminal step is the goal."""

Row = dict[str, Any]


class Step(NamedTuple):
    """What one tick brought to N walkers; entries of walkers that took no step are not read.

    Attributes:
        live: whether a step was taken, bool [N].
        reward: r(s, a) of the environment, [N].
        shaped: the reward of equation (7), [N].
        terminated: the environment's end of the task, bool [N].
        truncated: the environment's time limit, bool [N].
        human_reset: whether the human ended the episode, bool [N].
        control: u_t, bool [N].
        human_action: whether the human's action was executed, bool [N].
        began: whether an intervention began, bool [N].
        alarmed: C, bool [N].
        dangerous: h_t = 0, bool [N].
        boundary: τ_t, [N]; NaN where there is none.
    """

    live: np.ndarray
    reward: np.ndarray
    shaped: np.ndarray
    terminated: np.ndarray
    truncated: np.ndarray
    human_reset: np.ndarray
    control: np.ndarray
    human_action: np.ndarray
    began: np.ndarray
    alarmed: np.ndarray
    dangerous: np.ndarray
    boundary: np.ndarray


_COUNTS = (
    "return",
    "shaped_return",
    "length",
    "interventions",
    "intervened_steps",
    "human_steps",
    "alarms",
    "true_alarms",
    "false_alarms",
    "boundary_sum",
)


def fall_at_once() -> Row:
    """The row of an episode that could not be played since the numbers were not finite.

    It counts against the method, as a fall in the first step.
    """
    counts = dict.fromkeys(("interventions", "human_steps", "alarms", "true_alarms"), 0)
    unknown = dict.fromkeys(("mean_boundary", "final_boundary", "lead_steps"), float("nan"))
    return {
        "return": FALL_REWARD,
        "shaped_return": FALL_REWARD,
        "length": 1,
        "fall": 1,
        "end": "fall",
        "false_alarms": 0,
        "alarms_before_fall": 0,
        **counts,
        **unknown,
    }


class EpisodeCounter:
    """Running totals of the episode that each walker is in."""

    def __init__(self, num_walkers: int):
        self._totals = np.zeros((len(_COUNTS), num_walkers))
        # Whether a step raised an alarm, of the last k steps; step i at i mod k.
        self._recent = np.zeros((ALARM_WINDOW, num_walkers), bool)
        self._walkers = np.arange(num_walkers)

    def clear(self, walker: int) -> None:
        """Forgets a walker's unfinished episode."""
        self._totals[:, walker] = 0.0
        self._recent[:, walker] = False

    def state_of(self, walker: int) -> tuple[np.ndarray, np.ndarray]:
        """Copies of a walker's totals and of its last alarms, of the unfinished episode."""
        return self._totals[:, walker].copy(), self._recent[:, walker].copy()

    def restore(self, walker: int, totals: np.ndarray, alarms: np.ndarray) -> None:
        """Puts back what `state_of` gave."""
        self._totals[:, walker] = totals
        self._recent[:, walker] = alarms

    def length_of(self, walker: int) -> int:
        """Steps so far of a walker's unfinished episode."""
        return int(self._totals[_COUNTS.index("length"), walker])

    def intervened(self, control: np.ndarray) -> np.ndarray:
        """Whether u was 1 at any step of this episode, this step included, bool [N]."""
        return control | (self._totals[_COUNTS.index("intervened_steps")] > 0)

    def count(self, step: Step) -> list[tuple[int, Row]]:
        """Adds one tick.

        Args:
            step: what the tick brought.

        Returns:
            (walker, row) of each episode that ended: the measures that training and test share.
        """
        live = step.live
        place = self._totals[_COUNTS.index("length")].astype(int) % ALARM_WINDOW
        self._recent[place, self._walkers] = step.alarmed
        added = (  # In the order of `_COUNTS`.
            step.reward,
            step.shaped,
            live,
            step.began,
            step.control,
            step.human_action,
            step.alarmed,
            step.alarmed & step.dangerous,
            step.alarmed & ~step.dangerous,
            step.boundary,
        )
        np.add(self._totals, added, out=self._totals, where=live)
        ended = live & (step.terminated | step.truncated | step.human_reset)
        return [(int(walker), self._finish(int(walker), step)) for walker in ended.nonzero()[0]]

    def _finish(self, walker: int, step: Step) -> Row:
        totals = dict(zip(_COUNTS, self._totals[:, walker].tolist(), strict=True))
        fall = bool(step.terminated[walker]) and float(step.reward[walker]) <= FALL_REWARD
        recent = self._recent[:, walker]
        oldest = int(totals["length"]) % ALARM_WINDOW
        # A fall among thousands of walkers is frequent, and NumPy's own roll slow.
        oldest_first = np.concatenate([recent[oldest:], recent[:oldest]])
        timely = np.flatnonzero(oldest_first) if fall else np.empty(0, int)
        row: Row = {
            "return": totals["return"],
            "shaped_return": totals["shaped_return"],
            "length": int(totals["length"]),
            "interventions": int(totals["interventions"]),
            "human_steps": int(totals["human_steps"]),
            "alarms": int(totals["alarms"]),
            "true_alarms": int(totals["true_alarms"]),
            "false_alarms": int(totals["false_alarms"]),
            "fall": int(fall),
            "end": _how_it_ended(fall, walker, step),
            "mean_boundary": totals["boundary_sum"] / totals["length"],
            "final_boundary": float(step.boundary[walker]),
            "alarms_before_fall": len(timely),
            "lead_steps": float(ALARM_WINDOW - 1 - timely[0]) if len(timely) else float("nan"),
        }
        self.clear(walker)
        return row


def _how_it_ended(fall: bool, walker: int, step: Step) -> str:
    if fall:
        return "fall"
    if step.terminated[walker]:
        return "goal"
    return "human-reset" if step.human_reset[walker] else "time-limit"
