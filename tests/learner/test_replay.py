import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hitl_jax.learner import frame, replay

_LAYOUT = frame.Layout(observation_size=1, action_size=1)
_RUNS = 2


def _frames(count, first=0, terminated=(), truncated=(), final=()):
    """Frames of two runs whose observation is the frame's number (+1000 in the second run)."""
    frames = np.zeros((_RUNS, count, _LAYOUT.width), np.float32)
    numbers = np.arange(first, first + count)
    for run in range(_RUNS):
        frames[run, :, 0] = numbers + 1000 * run
        frames[run, :, 1] = -numbers
        frames[run, :, _LAYOUT.reward] = numbers
        frames[run, :, _LAYOUT.boundary] = numbers / 10
        frames[run, :, _LAYOUT.next_boundary] = numbers / 10 + 0.5
        frames[run, :, _LAYOUT.boundary_reward] = 0.25
        for column, where in (
            ("terminated", terminated),
            ("truncated", truncated),
            ("final", final),
        ):
            frames[run, :, getattr(_LAYOUT, column)] = np.isin(numbers, where)
    return jnp.asarray(frames)


def _filled(capacity, *frames):
    memory = replay.init(capacity, _RUNS, _LAYOUT)
    for chunk in frames:
        memory = replay.add(memory, chunk)
    return memory


def _sample(memory, column=0, n_step=3, gamma=0.5, batch=512, seed=0):
    drawn = replay.draw(memory, _LAYOUT, column, jax.random.key(seed), batch, n_step, gamma)
    return replay.read(memory, _LAYOUT, column, drawn)


def test_n_step_by_hand():
    batch = _sample(_filled(16, _frames(8)))
    start = np.asarray(batch.observation[:, 0])
    assert set(start) == {0, 1, 2, 3, 4}  # frame 5 would need frame 8 for its bootstrap
    # From frame 2: 2 + 0.5 * 3 + 0.25 * 4 = 4.5, discount 0.125, bootstrap at frame 5.
    index = int(np.flatnonzero(start == 2)[0])
    np.testing.assert_allclose(batch.reward[index], 4.5)
    np.testing.assert_allclose(batch.discount[index], 0.125)
    np.testing.assert_allclose(batch.next_observation[index], [5.0])
    np.testing.assert_allclose(batch.action[index], [-2.0])


def test_runs_are_not_mixed():
    batch = _sample(_filled(16, _frames(8)), column=1)
    assert (np.asarray(batch.observation) >= 1000).all()
    assert (np.asarray(batch.next_observation) >= 1000).all()


@pytest.mark.parametrize("ending", ["terminated", "truncated"])
def test_an_ending_cuts_the_window_and_only_termination_cuts_the_bootstrap(ending):
    # The episode ends with the step from frame 4; frame 5 holds its final observation.
    batch = _sample(_filled(24, _frames(12, final=[5], **{ending: [4]})))
    start = np.asarray(batch.observation[:, 0])
    assert 5 not in start
    index = int(np.flatnonzero(start == 3)[0])
    # From frame 3 two steps are left: 3 + 0.5 * 4 = 5.
    np.testing.assert_allclose(batch.reward[index], 5.0)
    np.testing.assert_allclose(batch.next_observation[index], [5.0])
    np.testing.assert_allclose(batch.discount[index], 0.0 if ending == "terminated" else 0.25)
    # The last step of the episode: one step, then the final observation.
    index = int(np.flatnonzero(start == 4)[0])
    np.testing.assert_allclose(batch.reward[index], 4.0)
    np.testing.assert_allclose(batch.next_observation[index], [5.0])
    np.testing.assert_allclose(batch.discount[index], 0.0 if ending == "terminated" else 0.5)
    # A whole window before the end: the bootstrap is untouched.
    index = int(np.flatnonzero(start == 1)[0])
    np.testing.assert_allclose(batch.discount[index], 0.125)


def test_the_first_frame_of_a_run_is_never_drawn():
    """It is a reset's: what it holds was seen before the run began."""
    starts = np.asarray(_sample(_filled(16, _frames(8, final=[0]))).observation[:, 0])
    assert set(starts) == {1, 2, 3, 4}


def test_starts_are_uniform_over_steps_in_spite_of_final_frames():
    memory = _filled(16, _frames(16, truncated=[3, 9], final=[4, 10]))
    batch = _sample(memory, batch=60_000)
    starts, counts = np.unique(np.asarray(batch.observation[:, 0]), return_counts=True)
    assert set(starts) == set(range(13)) - {4, 10}
    # Both draws are final with probability (2/13)^2; then one of the frames before a final one.
    fallback = 60_000 * (2 / 13) ** 2
    expected = (60_000 - fallback) / 11 + np.where(np.isin(starts, [3, 9]), fallback / 2, 0)
    assert (np.abs(counts - expected) < 4 * np.sqrt(expected)).all()


def test_wrap_around_keeps_whole_windows_of_the_newest_frames():
    memory = _filled(16, *(_frames(4, first) for first in range(0, 40, 4)))
    batch = _sample(memory, batch=2000)
    start = np.asarray(batch.observation[:, 0])
    # Frames 24..39 are held; a window of three steps starts at 24..36.
    assert set(start) == set(range(24, 37))
    np.testing.assert_allclose(batch.next_observation[:, 0], start + 3)
    np.testing.assert_allclose(batch.reward, start + 0.5 * (start + 1) + 0.25 * (start + 2))


def test_a_new_run_does_not_see_the_frames_of_the_one_before():
    memory = replay.begin_run(_filled(16, _frames(8)), 1)
    memory = replay.add(memory, _frames(8, first=100))
    assert int(replay.num_starts(memory, 0, 3)) == 13
    assert int(replay.num_starts(memory, 1, 3)) == 5
    assert (np.asarray(_sample(memory, column=1).observation) >= 1100).all()


def test_the_pool_of_the_boundary():
    memory = _filled(16, _frames(8, terminated=[4], final=[5]))
    pool = replay.sample_boundary(memory, _LAYOUT, 0, jax.random.key(0), 256, 0.9)
    start = np.asarray(pool.observation[:, 0])
    assert set(start) == {0, 1, 2, 3, 4, 6}
    np.testing.assert_allclose(pool.boundary, start / 10, rtol=1e-6)
    np.testing.assert_allclose(pool.next_boundary, start / 10 + 0.5, rtol=1e-6)
    np.testing.assert_allclose(pool.reward, start + 0.25)
    np.testing.assert_allclose(pool.next_observation[:, 0], start + 1)
    np.testing.assert_allclose(pool.discount, np.where(start == 4, 0.0, 0.9), rtol=1e-6)


def test_a_write_that_could_wrap_is_refused():
    with pytest.raises(ValueError, match="multiple"):
        replay.add(replay.init(10, _RUNS, _LAYOUT), _frames(4))


def test_donated_writes_happen_in_place():
    add = jax.jit(replay.add, donate_argnums=0)
    memory = add(replay.init(1024, _RUNS, _LAYOUT), _frames(8))
    before = [ring.unsafe_buffer_pointer() for ring in (memory.seen, memory.outcome)]
    memory = add(memory, _frames(8))
    after = [ring.unsafe_buffer_pointer() for ring in (memory.seen, memory.outcome)]
    assert after == before


def test_jit_and_vmap_agree_with_plain_calls():
    memory = _filled(24, _frames(12, truncated=[5], final=[6]))
    keys = jax.random.split(jax.random.key(1), _RUNS)

    def one(column, key):
        drawn = replay.draw(memory, _LAYOUT, column, key, 64, 3, 0.9)
        return replay.read(memory, _LAYOUT, column, drawn)

    together = jax.jit(jax.vmap(one))(jnp.arange(_RUNS), keys)
    for run in range(_RUNS):
        alone = one(run, keys[run])
        chex.assert_trees_all_close(jax.tree.map(lambda x, r=run: x[r], together), alone, rtol=1e-6)
