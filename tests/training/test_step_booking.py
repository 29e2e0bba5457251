import jax.numpy as jnp
import numpy as np
import pytest
from paper_team import paper_config, paper_hyper

from hitl_jax.config import Method, hyper_for
from hitl_jax.envs import StepBatch
from hitl_jax.learner.frame import CUT_OFF, FALL, FINISHED, GOES_ON, Layout
from hitl_jax.results.episode_measures import UNKNOWN_ENDS, WALKER_ENDS
from hitl_jax.results.recorded_episodes import Recording
from hitl_jax.training.step_booking import (
    end_of_step,
    episode_of,
    finite_decision,
    frames_of,
    recorded_steps,
    stored_ends,
    write_answer,
)

_LAYOUT = Layout(3, 2)
_LOGGED = _LAYOUT.without_observation
_HYPER = hyper_for(Method.HITL_AC, paper_hyper(feedback=-10.0))


def _steps(count, layout=_LAYOUT, **flags):
    """Steps of reward 1; flags say at which ones they are set."""
    steps = np.zeros((count, layout.step_width), np.float32)
    steps[:, layout.reward] = 1.0
    for name, places in flags.items():
        steps[places, getattr(layout, name)] = 1.0
    return steps


def _frames(config, intervened=False, weight=1.0, **flags):
    steps = _steps(4, **flags)
    before, rewards = np.array([intervened]), (np.array([weight]), np.array([-10.0]))
    frames, after = frames_of(steps[None], _LAYOUT, config, *rewards, before, WALKER_ENDS)
    [frames] = frames
    ends = frames[:, _LAYOUT.terminated].tolist(), frames[:, _LAYOUT.truncated].tolist()
    return frames[:, _LAYOUT.reward].tolist(), ends, bool(after[0])


def test_what_the_plant_answers_stands_in_the_step():
    rows = np.stack([_steps(1, human_reset=[0])[0], _steps(1)[0], _steps(1)[0]])
    flags = np.array([[False, False], [False, True], [False, False]])
    answer = StepBatch(np.zeros((3, 3)), np.array([5.0, 6.0, 7.0]), *flags.T)
    live, begins = np.array([True] * 3), np.array([False] * 3)
    end = end_of_step(rows, answer, _LAYOUT, live, begins)
    assert end.ended.tolist() == [True, True, False]
    write_answer(rows, answer, _LAYOUT)
    assert rows[:, _LAYOUT.reward].tolist() == [5.0, 6.0, 7.0]
    assert rows[:, _LAYOUT.truncated].tolist() == [0.0, 1.0, 0.0]


@pytest.mark.parametrize("ends", [False, True])
def test_a_reset_by_the_human_ends_the_episode_and_perhaps_the_bootstrap(ends):
    config = paper_config(human_reset_terminates=ends)
    rewards, told, _ = _frames(config, control=[1], human_reset=[1], final=[2])
    assert rewards == [1.0, -9.0, 0.0, 1.0]
    reset, never = [0.0, 1.0, 0.0, 0.0], [0.0] * 4
    assert told == ((reset, never) if ends else (never, reset))


def test_feedback_after_each_episode_comes_once_with_its_end():
    config = paper_config(feedback_schedule="episode")
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
    rewards, ends, after = _frames(paper_config(), final=[0, 1, 2, 3], control=[0], human_reset=[1])
    assert rewards == [0.0] * 4
    assert ends == ([0.0] * 4, [0.0] * 4)
    assert not after


@pytest.mark.parametrize(
    ("event", "flags"),
    [
        (GOES_ON, ()),
        (GOES_ON, ("control",)),  # A penalty: the machine goes on acting.
        (FALL, ("terminated", "fell")),
        (FALL, ("terminated", "truncated", "fell")),
        (FALL, ("terminated", "human_reset", "fell")),
        (FINISHED, ("terminated",)),
        (CUT_OFF, ("truncated",)),
        (CUT_OFF, ("human_reset",)),
        (CUT_OFF, ("human_action",)),
        (CUT_OFF, ("terminated", "human_action", "fell")),  # The human's fall.
        (GOES_ON, ("final", "terminated", "human_reset", "fell")),  # No step was taken.
    ],
)
def test_what_became_of_the_machines_walk_is_stored(event, flags):
    steps = _steps(1, **{name: [0] for name in flags if name != "fell"})
    if "fell" in flags:
        steps[0, _LAYOUT.reward] = -100.0
    given = paper_config(), np.ones(1), np.zeros(1), np.zeros(1, bool)
    frames, _ = frames_of(steps[None], _LAYOUT, *given, WALKER_ENDS)
    assert frames[0, 0, _LAYOUT.event] == event
    frames, _ = frames_of(steps[None], _LAYOUT, *given, UNKNOWN_ENDS)
    assert frames[0, 0, _LAYOUT.event] == (GOES_ON if event == GOES_ON else CUT_OFF)


def test_the_environments_reward_counts_as_much_as_its_weight():
    """0 leaves the human's feedback alone, in the replay and in the episode's table."""
    config, begins = paper_config(feedback_schedule="onset"), {"control": [1, 2], "began": [1]}
    assert _frames(config, weight=0.0, **begins)[0] == [0.0, -10.0, 0.0, 0.0]
    assert _frames(config, weight=0.5, **begins)[0] == [0.5, -9.5, 0.5, 0.5]
    hyper = _HYPER.replace(reward_weight=0.0)
    episode = episode_of(_steps(3, _LOGGED, terminated=[2], **begins), _LOGGED, config, hyper)
    assert (episode.reward.sum(), episode.shaped.sum()) == (3.0, -10.0)


def test_of_weight_0_a_loss_is_no_negative_zero():
    steps = _steps(3, _LOGGED, terminated=[2])
    steps[:, _LOGGED.reward] = -1.0
    hyper = _HYPER.replace(reward_weight=0.0)
    shaped = episode_of(steps, _LOGGED, paper_config(), hyper).shaped
    assert not shaped.any() and not np.signbit(shaped).any()


@pytest.mark.parametrize(
    ("schedule", "total"), [("step", -17.0), ("onset", -7.0), ("episode", -7.0)]
)
def test_an_episode_tells_both_rewards(schedule, total):
    config = paper_config(feedback_schedule=schedule)
    steps = _steps(3, _LOGGED, control=[0, 1], began=[0], terminated=[2])
    episode = episode_of(steps, _LOGGED, config, _HYPER)
    assert (episode.reward.sum(), episode.shaped.sum()) == (3.0, total)
    assert (episode.began.tolist(), bool(episode.terminated[-1])) == ([True, False, False], True)


def test_where_nobody_arbitrates_there_is_no_boundary():
    hyper = hyper_for(Method.SRL, paper_hyper())
    steps = _steps(2, _LOGGED, alarmed=[1])
    assert np.isnan(episode_of(steps, _LOGGED, paper_config(), hyper).boundary).all()
    for each, known in ((hyper, False), (_HYPER, True)):
        kept = Recording(1, recorded_steps(steps, _LOGGED, each))
        assert np.isfinite(kept.column("boundary")).all() == known
        assert kept.column("alarmed").tolist() == [0.0, 1.0]
        assert kept.actions.shape == (2, 2)


def _answer(**changes):
    """What four walkers answer: the first falls, the second's time is up, the others go on."""
    told = {
        "observation": np.zeros((4, 3), np.float32),
        "reward": np.zeros(4, np.float32),
        "terminated": np.array([True, False, False, False]),
        "truncated": np.array([False, True, False, False]),
    }
    return StepBatch(**told | changes)


@pytest.mark.parametrize("asarray", [np.asarray, jnp.asarray])
def test_what_is_not_finite_ends_no_episode_and_is_named(asarray):
    rows = _steps(4, human_reset=[2])
    seen = np.zeros((4, 3), np.float32)
    seen[0, 1], reward = np.nan, np.array([0.0, np.inf, 0.0, np.nan], np.float32)
    live, begins = np.array([True, True, True, False]), np.array([False, False, False, True])
    answer = StepBatch(*map(asarray, _answer(observation=seen, reward=reward)))
    end = end_of_step(asarray(rows), answer, _LAYOUT, asarray(live), asarray(begins))
    assert end.finite["observation"].tolist() == [False, True, True, True]
    assert end.finite["reward"].tolist() == [True, False, True, True]  # The last was only reset.
    assert end.sound.tolist() == [False, False, True, True]
    assert end.ended.tolist() == [False, False, True, False]


def test_a_walker_that_stands_still_is_not_looked_at():
    idle, nan = np.zeros(4, bool), np.full(4, np.nan, np.float32)
    answer = _answer(reward=nan, observation=np.full((4, 3), np.nan))
    end = end_of_step(_steps(4), answer, _LAYOUT, idle, idle)
    assert end.sound.all()
    assert not end.ended.any()


def test_a_decision_is_looked_at_before_the_step():
    rows = _steps(3)
    rows[0, _LAYOUT.action.start + 1] = np.inf
    rows[1, _LAYOUT.boundary] = np.nan
    rows[2, _LAYOUT.observation] = np.nan  # It was looked at as it came.
    told = {name: finite.tolist() for name, finite in finite_decision(rows, _LAYOUT).items()}
    assert told == {"action": [False, True, True], "boundary": [True, False, True]}


def test_an_end_is_stored_with_or_without_the_bootstrap():
    terminated, truncated, reset = np.array(
        [[1, 0, 0, 0, 1, 0], [0, 1, 0, 0, 1, 1], [0, 0, 1, 0, 0, 1]], bool
    )
    with_end = stored_ends(terminated, truncated, reset, True)
    assert [flags.tolist() for flags in with_end] == [
        [True, False, True, False, True, True],
        [False, True, False, False, False, False],
    ]
    without = stored_ends(terminated, truncated, reset, False)
    assert [flags.tolist() for flags in without] == [
        [True, False, False, False, True, False],
        [False, True, True, False, False, True],
    ]
