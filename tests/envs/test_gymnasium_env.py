"""Our walkers behind gymnasium's interfaces: equal to gymnasium's own, step by step."""

import gymnasium
import numpy as np
import pytest
from official import needs_official

from hitl_jax.envs import OUR_WALKERS

_STEPS = 60
_OURS = "hitl_jax.envs.gymnasium_env:hitl_jax/"


def _episode(env, seed):
    env.action_space.seed(0)
    seen = [env.reset(seed=seed)[0]]
    rows = []
    for _ in range(_STEPS):
        observation, reward, terminated, truncated, _ = env.step(env.action_space.sample())
        seen.append(observation)
        rows.append((np.float32(reward), terminated, truncated))
        if terminated or truncated:
            break
    env.close()
    return np.array(seen), rows


@needs_official
@pytest.mark.parametrize("env_id", OUR_WALKERS)
def test_one_walker_is_gymnasiums_own(env_id):
    ours, known = (gymnasium.make(name) for name in (f"{_OURS}{env_id}", env_id))
    for one, other in zip(_episode(ours, 3), _episode(known, 3), strict=True):
        np.testing.assert_array_equal(one, other)


@needs_official
def test_many_walkers_are_single_ones_and_begin_anew_after_their_last_step():
    many = gymnasium.make_vec(f"{_OURS}BipedalWalker-v3", num_envs=3)
    assert many.single_observation_space.shape == (24,)
    assert many.metadata["autoreset_mode"] == gymnasium.vector.AutoresetMode.NEXT_STEP
    first, _ = many.reset(seed=7)
    ones = [gymnasium.make("BipedalWalker-v3") for _ in range(3)]
    np.testing.assert_array_equal(
        first, [env.reset(seed=7 + place)[0] for place, env in enumerate(ones)]
    )
    rng, ended, ends = np.random.default_rng(0), np.zeros(3, bool), 0
    for _ in range(300):
        actions = rng.uniform(-1, 1, (3, 4)).astype(np.float32)
        observation, reward, terminated, truncated, _ = many.step(actions)
        for place, env in enumerate(ones):
            if ended[place]:
                assert reward[place] == 0 and not terminated[place] and not truncated[place]
                ones[place] = None
            elif env is not None:
                answer = env.step(actions[place])
                np.testing.assert_array_equal(observation[place], answer[0])
                assert (reward[place], terminated[place]) == (np.float32(answer[1]), answer[2])
        ended = terminated | truncated
        ends += ended.sum()
    many.close()
    assert ends > 1


def test_equal_seeds_have_equal_terrain_and_others_others():
    env = gymnasium.make(f"{_OURS}BipedalWalker-v3")
    one, again, other = (env.reset(seed=seed)[0] for seed in (5, 5, 6))
    np.testing.assert_array_equal(one, again)
    assert (one != other).any()
    anew = env.reset()[0]
    assert (anew != other).any()
    env.close()
