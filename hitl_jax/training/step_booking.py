"""The rule that ends an episode, and the frames and episodes that are made of steps.

`end_of_step` has the one rule by which an episode ends and by which numbers count as not finite: in
training on the host and on the device, in both examiners, and in a live session. The rest is NumPy:
the replay learns from frames, which are steps with the reward of equation (7); the host keeps
the steps of an episode, from the action on, until the episode has ended.
"""

import functools
from typing import NamedTuple

import chex
import numpy as np

from hitl_jax.arbiter import shaped_reward
from hitl_jax.config import AgentConfig, RunHyper
from hitl_jax.envs import StepBatch
from hitl_jax.learner.frame import CUT_OFF, FALL, FINISHED, GOES_ON, Layout, flag_of, flags_of
from hitl_jax.results.episode_measures import EndRule, Episode
from hitl_jax.results.recorded_episodes import STEP_COLUMNS


class StepEnd(NamedTuple):
    """Which episodes ended at a tick, and which numbers are finite; NumPy or JAX arrays, as given.

    Attributes:
        finite: whether what the walkers answered is finite, bool [N] each, by quantity:
            `observation`, `reward`. True where a walker was not moved.
        ended: whether the episode ends with this step, bool [N].
    """

    finite: dict[str, chex.Array]
    ended: chex.Array

    @property
    def sound(self) -> chex.Array:
        """Whether all that was answered is finite, bool [N]."""
        return self.finite["observation"] & self.finite["reward"]


def finite_decision(rows: chex.Array, layout: Layout) -> dict[str, chex.Array]:
    """Whether what acting decided is finite, bool [N] each, by quantity: `action`, `boundary`.

    Asked before the step is taken: a walker is not told numbers that are not finite.

    Args:
        rows: packed ticks, [N, W + 6].
        layout: their columns.
    """
    isfinite = rows.__array_namespace__().isfinite
    return {
        "action": isfinite(rows[:, layout.action]).all(axis=1),
        "boundary": isfinite(rows[:, layout.boundary]),
    }


def end_of_step(
    rows: chex.Array, answer: StepBatch, layout: Layout, live: chex.Array, begins: chex.Array
) -> StepEnd:
    """Whether a step ended its episode, and whether what the walkers answered is finite.

    Where something is not finite, nothing that was answered counts: a run diverges there, a test
    episode is lost.

    Args:
        rows: packed ticks, [N, W + 6].
        answer: of the walkers.
        layout: columns of the rows.
        live: who took a step, bool [N].
        begins: who was reset, bool [N].
    """
    isfinite = answer.reward.__array_namespace__().isfinite
    finite = {
        "observation": isfinite(answer.observation).all(axis=1) | ~(live | begins),
        "reward": isfinite(answer.reward) | ~live,
    }
    ended = _ended(answer.terminated, answer.truncated, flag_of(rows, layout, "human_reset"))
    return StepEnd(finite, live & finite["observation"] & finite["reward"] & ended)


def _ended(terminated: chex.Array, truncated: chex.Array, human_reset: chex.Array) -> chex.Array:
    """The rule, bool [...] as each argument.

    An episode ends where the environment terminates it (a fall, the goal) or truncates it (its time
    is up), and where the human resets the walker.
    """
    return terminated | truncated | human_reset


def write_answer(rows: np.ndarray, answer: StepBatch, layout: Layout) -> None:
    """Writes what the walkers answered into packed ticks [N, W + 6], in place (NumPy)."""
    rows[:, layout.reward] = answer.reward
    rows[:, layout.terminated] = answer.terminated
    rows[:, layout.truncated] = answer.truncated


def stored_ends(
    terminated: np.ndarray,
    truncated: np.ndarray,
    human_reset: np.ndarray,
    reset_terminates: bool | np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """How an end is stored: whether with the bootstrap, and whether without, bool [...] each.

    Args:
        terminated: the environment ended the task, bool [...].
        truncated: the environment cut the episode off, bool [...].
        human_reset: the human ended the episode, bool [...].
        reset_terminates: whether that ends the bootstrap, bool or [...].

    Returns:
        `terminated` and `truncated` of the stored frame; at most one is true.
    """
    ends = terminated | (human_reset & reset_terminates)
    return ends, (truncated | human_reset) & ~ends


def event_of(
    reward: np.ndarray,
    terminated: np.ndarray,
    truncated: np.ndarray,
    human_reset: np.ndarray,
    human_action: np.ndarray,
    ends: EndRule,
) -> np.ndarray:
    """What became of the machine's walk in a step, see `learner.frame`; [...] as each argument.

    A fall in a step in which the human acts is not the machine's.

    Args:
        reward: r(s, a) of the environment.
        terminated: the environment ended the task, bool.
        truncated: the environment cut the episode off, bool.
        human_reset: the human ended the episode, bool.
        human_action: the human's action was executed, bool.
        ends: what it means that the environment ends an episode.
    """
    fell = np.zeros_like(terminated)
    if ends.fall_reward is not None:
        fell = terminated & (reward <= ends.fall_reward)
    finished = terminated & ~fell & ends.goal
    cut = truncated | human_reset | terminated
    event = np.select(
        [human_action, fell, finished, cut], [CUT_OFF, FALL, FINISHED, CUT_OFF], GOES_ON
    )
    return event.astype(np.float32)


def frames_of(
    steps: np.ndarray,
    layout: Layout,
    config: AgentConfig,
    weight: np.ndarray,
    feedback: np.ndarray,
    intervened: np.ndarray,
    ends: EndRule,
) -> tuple[np.ndarray, np.ndarray]:
    """Frames for the replay.

    Args:
        steps: of R runs at U ticks, [R, U, W + 6]; zeros where the plant was not asked.
        layout: columns.
        config: when the human's feedback is given, and whether a reset ends the bootstrap.
        weight: of the environment's reward, [R].
        feedback: r(s, a^h), [R].
        intervened: whether the human intervened in the episode under way before, bool [R].
        ends: what it means that the environment ends an episode.

    Returns:
        Frames [R, U, W], and `intervened` after them.
    """
    frames = steps[..., : layout.width].copy()
    live = frames[..., layout.final] == 0.0
    control = live & flag_of(steps, layout, "control")
    human_reset = live & flag_of(steps, layout, "human_reset")
    terminated = frames[..., layout.terminated] > 0.0
    truncated = frames[..., layout.truncated] > 0.0
    ended = _ended(terminated, truncated, human_reset)
    so_far, intervened = _intervened(control, ended, intervened)
    reward, schedule = frames[..., layout.reward], config.feedback_schedule
    began = live & flag_of(steps, layout, "began")
    shaped = shaped_reward(
        reward, control, feedback[:, None], schedule, began, ended, so_far, weight[:, None]
    )
    human_action = flag_of(steps, layout, "human_action")
    event = event_of(reward, terminated, truncated, human_reset, human_action, ends)
    frames[..., layout.event] = np.where(live, event, GOES_ON)
    frames[..., layout.reward] = np.where(live, shaped, 0.0)
    frames[..., layout.terminated], frames[..., layout.truncated] = stored_ends(
        terminated, truncated, human_reset, config.human_reset_terminates
    )
    return frames, intervened


def episode_of(steps: np.ndarray, layout: Layout, config: AgentConfig, hyper: RunHyper) -> Episode:
    """An episode that has ended.

    Args:
        steps: all of it, [T, A + 13].
        layout: their columns, see `Layout.without_observation`.
        config: when the human's feedback is given.
        hyper: the run's hyperparameters, host scalars.
    """
    flags = flags_of(steps, layout)
    reward, control = steps[:, layout.reward], flags.control
    ended = np.zeros(len(steps), bool)
    ended[-1] = True
    so_far = np.logical_or.accumulate(control)
    feedback, weight = float(hyper.feedback), float(hyper.reward_weight)
    given = config.feedback_schedule, flags.began, ended, so_far, weight
    shaped = shaped_reward(reward, control, feedback, *given) + 0.0  # −0 is written as 0.
    known = hyper.has_arbiter > 0
    return Episode(
        reward=reward,
        shaped=shaped,
        boundary=steps[:, layout.boundary] if known else np.full(len(steps), np.nan),
        terminated=steps[:, layout.terminated] > 0.0,
        began=flags.began,
        human_action=flags.human_action,
        alarmed=flags.alarmed,
        dangerous=flags.dangerous,
        human_reset=flags.human_reset,
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
    return [*range(layout.width)[layout.action], *(getattr(layout, name) for name in STEP_COLUMNS)]
