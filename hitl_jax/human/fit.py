"""Which simulated human a person is most like, by threshold of danger and reaction delay.

Fits `hitl_jax.human`'s danger ∘ delay to judgements; where the two disagree is counted as mistakes.
"""

from typing import NamedTuple

import numpy as np

from hitl_jax.human.params import MAX_DELAY


class FittedHuman(NamedTuple):
    """The simulated human whose judgements disagree least.

    Attributes:
        tolerance: signal from which a state is dangerous, in the signal's unit.
        delay: reaction delay [steps].
        missed: share of the person's dangerous steps that it finds safe; NaN where there are none.
        feared: share of the person's safe steps that it finds dangerous; NaN where there are none.
        disagrees: share of all steps on which they disagree.
    """

    tolerance: float
    delay: int
    missed: float
    feared: float
    disagrees: float


def fit_human(
    signal: np.ndarray, begins: np.ndarray, dangerous: np.ndarray, max_delay: int = MAX_DELAY
) -> FittedHuman:
    """The threshold and delay that explain most judgements; of equally good ones the least delay.

    Args:
        signal: what grows with danger at each step, such as |hull angle| [T].
        begins: whether the step is the first of an episode, bool [T].
        dangerous: the person's h_t = 0, bool [T].
        max_delay: the longest delay that is tried [steps].

    Returns:
        The fit.

    Raises:
        ValueError: if there are no steps, or the shapes differ.
    """
    shapes = {np.shape(array) for array in (signal, begins, dangerous)}
    if len(shapes) != 1 or np.ndim(signal) != 1 or not len(signal):
        raise ValueError(f"judgements of shapes {sorted(shapes)}: must be one, [T], with T > 0")
    since = _steps_since(begins)
    fits = (
        _fit(_delayed(signal, since, delay), dangerous, delay) for delay in range(max_delay + 1)
    )
    return min(fits, key=lambda fit: (fit.disagrees, fit.delay))


def _steps_since(begins: np.ndarray) -> np.ndarray:
    """Steps since the episode began, [T]."""
    places = np.arange(len(begins))
    return places - np.maximum.accumulate(np.where(begins, places, 0))


def _delayed(signal: np.ndarray, since: np.ndarray, delay: int) -> np.ndarray:
    """The signal of some steps ago; nothing is dangerous in an episode's first steps."""
    before = np.concatenate([np.full(delay, -np.inf), signal[: len(signal) - delay]])
    return np.where(since >= delay, before[: len(signal)], -np.inf)


def _fit(signal: np.ndarray, dangerous: np.ndarray, delay: int) -> FittedHuman:
    order = np.argsort(-signal, kind="stable")
    found, falls = signal[order], dangerous[order]
    # With the k greatest called dangerous: false ones among them, and true ones left out.
    feared = np.concatenate([[0], np.cumsum(~falls)])
    missed = falls.sum() - np.concatenate([[0], np.cumsum(falls)])
    allowed = np.concatenate([[True], np.append(found[:-1] > found[1:], True) & np.isfinite(found)])
    wrong = np.where(allowed, feared + missed, len(signal) + 1)
    best = int(np.argmin(wrong))
    return FittedHuman(
        tolerance=_between(found, best),
        delay=delay,
        missed=float(missed[best] / falls.sum()) if falls.any() else float("nan"),
        feared=float(feared[best] / (~falls).sum()) if (~falls).any() else float("nan"),
        disagrees=float(wrong[best] / len(signal)),
    )


def _between(found: np.ndarray, count: int) -> float:
    """A threshold that the first `count` of falling numbers reach, half way to the next."""
    above = found[count - 1] if count else np.inf
    below = found[count] if count < len(found) else -np.inf
    if not np.isfinite(below):
        return float(above)
    return float((above + below) / 2 if np.isfinite(above) else np.nextafter(below, np.inf))
