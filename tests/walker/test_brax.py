"""Brax's own wrappers and PPO run on the walker as a Brax environment."""

import jax
import numpy as np
import pytest

from hitl_jax.commands.brax_ppo import main
from hitl_jax.console.cli import BadInput
from hitl_jax.walker import brax_ppo
from hitl_jax.walker.brax_env import BipedalWalker

WALKERS = 16


def test_braxs_wrappers_accept_it():
    from brax.envs.wrappers import training  # After our filter of its warnings.

    env = training.wrap(BipedalWalker(), episode_length=1600)
    keys = jax.random.split(jax.random.PRNGKey(0), WALKERS)  # Brax knows no typed keys.
    state = jax.eval_shape(env.reset, keys)
    after = jax.eval_shape(env.step, state, jax.ShapeDtypeStruct((WALKERS, 4), np.float32))
    for one in (state, after):
        assert one.obs.shape == (WALKERS, env.observation_size) == (WALKERS, 24)
        assert one.reward.shape == one.done.shape == one.info["truncation"].shape == (WALKERS,)
    assert jax.tree.structure(state) == jax.tree.structure(after)
    assert env.action_size == 4


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_braxs_ppo_trains_on_it(monkeypatch):
    from brax.training.agents.ppo import train

    # No test is asked for, but Brax would compile a reset for one: half a minute.
    monkeypatch.setattr(train.acting, "Evaluator", lambda *_, **__: None)
    options = brax_ppo.PpoOptions(steps=512, walkers=WALKERS, unroll=16, evaluations=0)
    seen, policy, _ = brax_ppo.run(options, lambda *_: None)
    assert int(seen.count.lo if hasattr(seen.count, "lo") else seen.count) >= 512
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(policy))
    # Ten numbers of the observation are lidar's: shares of a ray.
    assert ((np.asarray(seen.mean)[14:] > 0) & (np.asarray(seen.mean)[14:] <= 1)).all()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"walkers": 20}, "--walkers 20: must be a multiple of 16"),
        ({"steps": 0}, "--steps 0: must be at least 1"),
    ],
)
def test_bad_options_are_refused(options, said):
    with pytest.raises(BadInput, match=said):
        main(brax_ppo.PpoOptions(**options))
