"""What became of the episodes near the end of training: whether it pays to be intervened on."""

import numpy as np

from hitl_jax.analysis.claims_on_training import mean_boundary
from hitl_jax.results.folder import Run
from hitl_jax.studies.ablations.store import Row

_PART = 5
"""The last of so many equal parts of training is looked at."""


def late_training(run: Run, unattended_every: int) -> Row:
    """Measures of the last episodes, None where there are none; the keys are `store.LATE`.

    Of the episodes that the human watched `late_intervened` is the share in which they intervened.
    The others are means over those with and without an intervention: of the return that is learned
    from, that of equation (7), and of the steps.

    Args:
        run: a finished run.
        unattended_every: its hyperparameter.
    """
    episodes = run.episodes
    count = len(episodes["interventions"])
    numbers = np.arange(1, count + 1)
    looked_at = numbers > count - max(count // _PART, 1)
    if unattended_every:
        looked_at &= numbers % unattended_every > 0
    intervened = episodes["interventions"][looked_at] > 0
    settled = mean_boundary(run)
    row = {
        "settled_boundary": None if np.isnan(settled) else settled,
        "late_intervened": _mean(intervened, np.ones_like(intervened)),
    }
    for name, column in (("return", "shaped_return"), ("steps", "length")):
        row[f"late_{name}_with"] = _mean(episodes[column][looked_at], intervened)
        row[f"late_{name}_without"] = _mean(episodes[column][looked_at], ~intervened)
    return row


def _mean(values: np.ndarray, of: np.ndarray) -> float | None:
    return float(values[of].mean()) if of.any() else None
