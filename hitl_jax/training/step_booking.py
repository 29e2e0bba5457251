"""Steps: what acting decided, packed by `team.packed_decision`, and what the plant answered.

The replay learns from frames, which are steps as the human's feedback shapes them; the host keeps
the steps of an episode, from the action on, until the episode has ended (host, NumPy).
"""

import functools

import numpy as np

from hitl_jax.config import AgentConfig, RunHyper
from hitl_jax.envs import StepBatch
from hitl_jax.learner.replay import Layout
from hitl_jax.results.episode_measures import Episode
from hitl_jax.results.recorded_episodes import STEP_COLUMNS
from hitl_jax.team import arbiter
from hitl_jax.team.packed_decision import CHECKED_COLUMNS, EXTRA_COLUMNS, flag_of


def step_width(layout: Layout) -> int:
    """Columns of a step, W + 6."""
    return layout.width + len(EXTRA_COLUMNS)


def logged_layout(layout: Layout) -> Layout:
    """The columns of a step that is kept, which begins with the action."""
    return layout._replace(observation_size=0)


def finite_decision(decided: np.ndarray, layout: Layout) -> np.ndarray:
    """Whether all that is checked of what acting gave is finite, bool [N].

    Args:
        decided: of N walkers, [N, W + 6].
        layout: its columns.
    """
    columns = [decided[:, getattr(layout, name)] for name in CHECKED_COLUMNS]
    return np.isfinite(np.column_stack(columns)).all(axis=1)


def finite_answer(answer: StepBatch) -> dict[str, np.ndarray]:
    """Whether the observation and the reward that the plant answered are finite, bool [N] each."""
    return {
        "observation": np.isfinite(answer.observation).all(axis=1),
        "reward": np.isfinite(answer.reward),
    }


def complete(decided: np.ndarray, answer: StepBatch, layout: Layout) -> np.ndarray:
    """Writes what the plant answered into what acting gave.

    Args:
        decided: of N walkers, [N, W + 6]; changed.
        answer: of the walkers.
        layout: its columns.

    Returns:
        Whether the episode ends, bool [N]; means nothing where no step was taken.
    """
    decided[:, layout.reward] = answer.reward
    decided[:, layout.terminated] = answer.terminated
    decided[:, layout.truncated] = answer.truncated
    return answer.terminated | answer.truncated | flag_of(decided, layout, "human_reset")


def frames_of(
    steps: np.ndarray,
    layout: Layout,
    config: AgentConfig,
    feedback: np.ndarray,
    intervened: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Frames for the replay.

    Args:
        steps: of R runs at U ticks, [R, U, W + 6]; zeros where the plant was not asked.
        layout: columns.
        config: when the human's feedback is given, and whether a reset ends the bootstrap.
        feedback: r(s, a^h), [R].
        intervened: whether the human intervened in the episode under way before, bool [R].

    Returns:
        Frames [R, U, W], and `intervened` after them.
    """
    frames = steps[..., : layout.width].copy()
    live = frames[..., layout.final] == 0.0
    control = live & flag_of(steps, layout, "control")
    human_reset = live & flag_of(steps, layout, "human_reset")
    terminated = frames[..., layout.terminated] > 0.0
    ended = terminated | (frames[..., layout.truncated] > 0.0) | human_reset
    so_far, intervened = _intervened(control, ended, intervened)
    reward, schedule = frames[..., layout.reward], config.feedback_schedule
    shaped = arbiter.shaped_reward(reward, control, feedback[:, None], schedule, ended, so_far)
    terminated |= human_reset & config.human_reset_terminates
    frames[..., layout.reward] = np.where(live, shaped, 0.0)
    frames[..., layout.terminated] = terminated
    frames[..., layout.truncated] = ended & ~terminated
    return frames, intervened


def episode_of(steps: np.ndarray, layout: Layout, config: AgentConfig, hyper: RunHyper) -> Episode:
    """An episode that has ended.

    Args:
        steps: all of it, [T, A + 13].
        layout: their columns, see `logged_layout`.
        config: when the human's feedback is given.
        hyper: the run's hyperparameters, host scalars.
    """
    names = ("began", "human_action", "alarmed", "dangerous", "human_reset")
    flags = {name: flag_of(steps, layout, name) for name in names}
    reward, control = steps[:, layout.reward], flag_of(steps, layout, "control")
    ended = np.arange(len(steps)) == len(steps) - 1
    so_far = np.logical_or.accumulate(control)
    shaped = arbiter.shaped_reward(
        reward, control, float(hyper.feedback), config.feedback_schedule, ended, so_far
    )
    known = hyper.has_arbiter > 0
    return Episode(
        reward=reward,
        shaped=shaped,
        boundary=steps[:, layout.boundary] if known else np.full(len(steps), np.nan),
        terminated=steps[:, layout.terminated] > 0.0,
        **flags,
    )


def recorded_steps(steps: np.ndarray, layout: Layout, hyper: RunHyper) -> np.ndarray:
    """What is recorded of steps (`hitl_jax.results.recorded_episodes`), [..., A + 5].

    Args:
        steps: [..., W + 6].
        layout: their columns.
        hyper: the run's hyperparameters, host scalars.
    """
    kept = steps[..., _recorded_columns(layout)]
    if not hyper.has_arbiter > 0:
        kept[..., layout.action_size + STEP_COLUMNS.index("boundary")] = np.nan
    return kept


def _intervened(
    control: np.ndarray, ended: np.ndarray, before: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Whether u was 1 in an episode so far, [R, U], where several follow; and before the next step.

    Args:
        control: u_t, bool [R, U].
        ended: whether the step ended its episode, bool [R, U].
        before: whether u was 1 before the first step in its episode, bool [R].
    """
    so_far = np.empty_like(control)
    for tick in range(control.shape[1]):
        so_far[:, tick] = before | control[:, tick]
        before = so_far[:, tick] & ~ended[:, tick]
    return so_far, before


@functools.cache
def _recorded_columns(layout: Layout) -> list[int]:
    """Where a recorded step stands in a step."""
    flags = {name: layout.width + place for place, name in enumerate(EXTRA_COLUMNS)}
    places = {"boundary": layout.boundary, **flags}
    return [*range(layout.width)[layout.action], *(places[name] for name in STEP_COLUMNS)]
