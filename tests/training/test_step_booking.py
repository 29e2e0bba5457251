import numpy as np
import pytest

from hitl_jax.config import AgentConfig, Hyper, Method, hyper_for
from hitl_jax.envs import StepBatch
from hitl_jax.learner.replay import Layout
from hitl_jax.results.recorded_episodes import Recording
from hitl_jax.team.packed_decision import EXTRA_COLUMNS
from hitl_jax.training.step_booking import (
    complete,
    episode_of,
    frames_of,
    logged_layout,
    recorded_steps,
    step_width,
)

_LAYOUT = Layout(3, 2)
_LOGGED = logged_layout(_LAYOUT)
_HYPER = hyper_for(Method.HITL_AC, Hyper(feedback=-10.0))


def _steps(count, layout=_LAYOUT, **flags):
    """Steps of reward 1; flags say at which ones they are set."""
    steps = np.zeros((count, step_width(layout)), np.float32)
    steps[:, layout.reward] = 1.0
    for name, places in flags.items():
        extra = name in EXTRA_COLUMNS
        column = layout.width + EXTRA_COLUMNS.index(name) if extra else getattr(layout, name)
        steps[places, column] = 1.0
    return steps


def _frames(config, intervened=False, **flags):
    steps = _steps(4, **flags)
    before = np.array([intervened])
    frames, after = frames_of(steps[None], _LAYOUT, config, np.array([-10.0]), before)
    [frames] = frames
    ends = frames[:, _LAYOUT.terminated].tolist(), frames[:, _LAYOUT.truncated].tolist()
    return frames[:, _LAYOUT.reward].tolist(), ends, bool(after[0])


def test_what_the_plant_answers_stands_in_the_step():
    rows = np.stack([_steps(1, human_reset=[0])[0], _steps(1)[0], _steps(1)[0]])
    flags = np.array([[False, False], [False, True], [False, False]])
    answer = StepBatch(np.zeros((3, 3)), np.array([5.0, 6.0, 7.0]), *flags.T)
    assert complete(rows, answer, _LAYOUT).tolist() == [True, True, False]
    assert rows[:, _LAYOUT.reward].tolist() == [5.0, 6.0, 7.0]
    assert rows[:, _LAYOUT.truncated].tolist() == [0.0, 1.0, 0.0]


@pytest.mark.parametrize("ends", [False, True])
def test_a_reset_by_the_human_ends_the_episode_and_perhaps_the_bootstrap(ends):
    config = AgentConfig(human_reset_terminates=ends)
    rewards, told, _ = _frames(config, control=[1], human_reset=[1], final=[2])
    assert rewards == [1.0, -9.0, 0.0, 1.0]
    reset, never = [0.0, 1.0, 0.0, 0.0], [0.0] * 4
    assert told == ((reset, never) if ends else (never, reset))


def test_feedback_after_each_episode_comes_once_with_its_end():
    config = AgentConfig(feedback_schedule="episode")
    rewards, _, after = _frames(config, control=[1, 3], truncated=[2])
    assert rewards == [1.0, 1.0, -9.0, 1.0]
    assert after
    rewards, _, after = _frames(config, truncated=[2])
    assert rewards == [1.0] * 4
    assert not after
    rewards, _, after = _frames(config, intervened=True, truncated=[2])
    assert rewards == [1.0, 1.0, -9.0, 1.0]
    assert not after


def test_where_no_step_was_taken_nothing_is_learned():
    rewards, ends, after = _frames(AgentConfig(), final=[0, 1, 2, 3], control=[0], human_reset=[1])
    assert rewards == [0.0] * 4
    assert ends == ([0.0] * 4, [0.0] * 4)
    assert not after


@pytest.mark.parametrize(("schedule", "total"), [("step", -17.0), ("episode", -7.0)])
def test_an_episode_tells_both_rewards(schedule, total):
    config = AgentConfig(feedback_schedule=schedule)
    steps = _steps(3, _LOGGED, control=[0, 1], began=[0], terminated=[2])
    episode = episode_of(steps, _LOGGED, config, _HYPER)
    assert (episode.reward.sum(), episode.shaped.sum()) == (3.0, total)
    assert (episode.began.tolist(), bool(episode.terminated[-1])) == ([True, False, False], True)


def test_where_nobody_arbitrates_there_is_no_boundary():
    hyper = hyper_for(Method.SRL, Hyper())
    steps = _steps(2, _LOGGED, alarmed=[1])
    assert np.isnan(episode_of(steps, _LOGGED, AgentConfig(), hyper).boundary).all()
    for each, known in ((hyper, False), (_HYPER, True)):
        kept = Recording(1, recorded_steps(steps, _LOGGED, each))
        assert np.isfinite(kept.column("boundary")).all() == known
        assert kept.column("alarmed").tolist() == [0.0, 1.0]
        assert kept.actions.shape == (2, 2)
