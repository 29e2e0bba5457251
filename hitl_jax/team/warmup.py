"""The warm-up of a run: until when it acts at random, and from when on it learns."""

import chex

from hitl_jax.config import RunHyper


def acts_at_random(hyper: RunHyper, steps: chex.Numeric) -> chex.Array:
    """Whether a run's actions are uniformly random; environment steps are counted.

    Args:
        hyper: the run's hyperparameters, scalars.
        steps: environment steps taken, [].
    """
    return steps < hyper.warmup_steps


def may_learn(hyper: RunHyper, ticks: int, chunk: int, n_step: int) -> bool:
    """Whether the learner is called at the end of a chunk; ticks are counted.

    A tick is an environment step, or the reset after an episode. A run therefore begins to learn
    some steps before it stops to act at random: as many as it has had episodes. The replay must
    hold two chunks, and a transition of n steps with both its ends, whatever the warm-up is.

    Args:
        hyper: the run's hyperparameters, host scalars.
        ticks: that the run has taken.
        chunk: ticks between two calls of the learner.
        n_step: steps of reward before the bootstrap.
    """
    return bool(ticks >= max(hyper.warmup_steps, 2 * chunk, n_step + 2))
