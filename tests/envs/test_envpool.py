"""The pool of EnvPool's walkers gives what EnvPool itself gives."""

import importlib.util
import sys

import numpy as np
import pytest
from toy_envs import IDLE, RESET, STEP, same, tick

from hitl_jax.envs import StepBatch, make_pool

needs_envpool = pytest.mark.skipif(
    importlib.util.find_spec("envpool") is None, reason="needs the extra `fast`"
)

# EnvPool warns when it makes some spaces.
narrows = pytest.mark.filterwarnings("ignore:.*precision lowered by casting:UserWarning")


def raw_envpool(num_walkers: int, seed: int):
    import envpool

    return envpool.make_gymnasium(
        "BipedalWalker-v3", num_envs=num_walkers, num_threads=1, seed=seed, max_episode_steps=10**6
    )


def test_envpool_missing(monkeypatch):
    monkeypatch.setitem(sys.modules, "envpool", None)
    with pytest.raises(ImportError, match=r'envpool.*pip install -e "\.\[fast\]"$') as caught:
        make_pool("envpool", 1)
    assert "\n" not in str(caught.value)


@needs_envpool
def test_envpool_pool_equals_envpool_until_a_human_resets():
    """Random actions; an ended walker is RESET in the tick in which EnvPool itself resets it."""
    rng = np.random.default_rng(0)
    raw = raw_envpool(4, seed=9)
    observation, _ = raw.reset()
    with make_pool("envpool", 4, 2, seed=9) as pool:
        assert (pool.num_walkers, pool.observation_size, pool.action_size) == (4, 24, 4)
        assert not pool.seedable
        batch = tick(pool, RESET)
        np.testing.assert_array_equal(batch.observation, observation)
        ended, falls = np.zeros(4, bool), 0
        for _ in range(200):
            action = rng.uniform(-1, 1, (4, 4)).astype(np.float32)
            batch = tick(pool, np.where(ended, RESET, STEP), action)
            same(batch, StepBatch(*raw.step(action)[:4]))
            ended = batch.terminated
            falls += ended.sum()
    assert falls >= 3


@needs_envpool
def test_envpool_human_reset_and_idle_change_no_other_walker():
    """Walker 0 steps as in EnvPool; 1 is reset at tick 20; 2 idles from tick 10 to 29."""
    action = np.full((3, 4), 0.2, np.float32)
    raw = raw_envpool(3, seed=2)
    raw.reset()
    truth = [raw.step(action) for _ in range(40)]
    with make_pool("envpool", 3, 1, seed=2) as pool:
        start = tick(pool, RESET)
        for number in range(40):
            idle = 10 <= number < 30
            command = [STEP, RESET if number == 20 else STEP, IDLE if idle else STEP]
            batch = tick(pool, command, action)
            seen = [number, number if number < 20 else None, min(number, 9) if idle else number]
            seen[2] = number - 20 if number >= 30 else seen[2]
            for walker, when in enumerate(seen):
                if when is not None:
                    np.testing.assert_array_equal(batch.observation[walker], truth[when][0][walker])
            if idle:
                assert not batch.reward[2]
                assert not batch.terminated[2]
            if number == 20:
                # Standing still in a new episode; another episode than the first.
                assert (batch.reward[1], batch.terminated[1], batch.truncated[1]) == (0, 0, 0)
                assert np.abs(batch.observation[1] - start.observation[1]).max() < 0.1
                assert not np.array_equal(batch.observation[1], start.observation[1])
            elif number == 21:
                assert batch.reward[1] != 0


@needs_envpool
def test_envpool_time_limit():
    """A limit at walker 0's fall: both flags for it, truncated alone for the others."""
    from hitl_jax.envs.envpool_pool import EnvpoolPool

    action = np.zeros((3, 4), np.float32)
    action[0] = (1, -1, 1, -1)
    raw = raw_envpool(3, seed=0)
    raw.reset()
    steps = 1
    while not (answer := raw.step(action))[2][0]:
        steps += 1
    assert not answer[2][1:].any()  # The others stand.
    with EnvpoolPool("BipedalWalker-v3", 3, 1, max_episode_steps=steps) as pool:
        tick(pool, RESET)
        for number in range(1, steps + 1):
            batch = tick(pool, STEP, action)
            assert batch.truncated.tolist() == [number == steps] * 3
        same(batch, StepBatch(*answer[:3], np.ones(3, bool)))
        assert batch.terminated.tolist() == [True, False, False]
        # A new episode, of `steps` steps again, whichever way the last one ended.
        final = batch.observation
        batch = tick(pool, RESET, action)
        assert not batch.reward.any()
        assert (np.abs(batch.observation - final).max(axis=1) > 0.01).all()
        action[0] = 0
        for number in range(1, steps + 1):
            batch = tick(pool, STEP, action)
            assert batch.truncated.tolist() == [number == steps] * 3
        assert not batch.terminated.any()


@needs_envpool
@narrows
def test_envpool_actions_are_scaled_onto_the_box():
    """Pendulum's torques are in [-2, 2]."""
    import envpool

    rng = np.random.default_rng(0)
    raw = envpool.make_gymnasium("Pendulum-v1", num_envs=3, num_threads=1, seed=4)
    raw.reset()
    with make_pool("envpool", 3, 2, "Pendulum-v1", seed=4) as pool:
        tick(pool, RESET)
        for _ in range(20):
            action = rng.uniform(-1, 1, (3, 1)).astype(np.float32)
            same(tick(pool, STEP, action), StepBatch(*raw.step(2 * action)[:4]))
        truth = raw.step(np.full((3, 1), -2, np.float32))
        same(tick(pool, STEP, -1.5), StepBatch(*truth[:4]))  # Clipped.


@needs_envpool
@narrows
@pytest.mark.parametrize(
    ("env_id", "what"),
    [("CartPole-v1", "action"), ("MountainCar-v0", "action"), ("FrozenLake-v1", "observation")],
)
def test_envpool_other_spaces_are_refused(env_id, what):
    with pytest.raises(ValueError, match=f"^env_id '{env_id}': {what}s must be flat vectors"):
        make_pool("envpool", 2, env_id=env_id)


@needs_envpool
def test_envpool_bad_arguments():
    with pytest.raises(ValueError, match="env_id 'Nope-v3': must be one of envpool"):
        make_pool("envpool", 1, env_id="Nope-v3")
    with pytest.raises(ValueError, match="seed -1: must be a whole number of at least 0"):
        make_pool("envpool", 1, seed=-1)
    with (
        make_pool("envpool", 1) as pool,
        pytest.raises(ValueError, match="STEP of walker 0: not in an episode"),
    ):
        tick(pool, STEP)
