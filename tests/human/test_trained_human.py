"""The human that comes with the package: expects falls that come, and can walk."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from paper_team import paper_config, paper_hyper

from hitl_jax.config import AgentConfig, Method, hyper_for
from hitl_jax.envs import Command, make_pool
from hitl_jax.errors import InvalidValue
from hitl_jax.human import HumanParams, experienced, trained_walker
from hitl_jax.human.experience import LEAST
from hitl_jax.human.indicator import WALKER_OBSERVATION
from hitl_jax.team import acting
from hitl_jax.team.agent import behavior, init, make_agent

_WALKERS = 8


def _walked(hands, steps=2000):
    """Returns and falls of walkers that hands walk alone, and what they saw."""
    act = jax.jit(jax.vmap(lambda seen: hands.act((), seen, jax.random.key(0))[1]))
    seeds = np.arange(_WALKERS, dtype=np.uint32)
    active, returns, fell, seen = np.ones(_WALKERS, bool), np.zeros(_WALKERS), 0, []
    with make_pool("lean", _WALKERS, 1) as pool:
        answer = pool.step(
            np.full(_WALKERS, Command.RESET, np.uint8), np.zeros((_WALKERS, 4), np.float32), seeds
        )
        for _ in range(steps):
            seen.append(answer.observation[active].copy())
            command = np.where(active, Command.STEP, Command.IDLE).astype(np.uint8)
            answer = pool.step(command, np.asarray(act(answer.observation)), seeds)
            returns += np.where(active, answer.reward, 0.0)
            fell += int((active & (answer.reward <= -90.0)).sum())
            active = active & ~(answer.terminated | answer.truncated)
            if not active.any():
                break
    return returns, fell, np.concatenate(seen)


def _judged(seen, least):
    part = experienced()
    params = HumanParams(extra={LEAST: least})

    def judge(observation):
        return part.judge((), params, observation, jnp.zeros((), bool), jax.random.key(0))[1]

    return np.asarray(jax.jit(jax.vmap(judge))(jnp.asarray(seen)))


def test_the_hands_walk_and_the_human_foresees_no_fall_of_theirs():
    returns, fell, seen = _walked(trained_walker())
    assert returns.mean() > 300.0 and fell == 0
    assert _judged(seen, 0.5).mean() < 0.05


def test_a_body_that_tips_over_is_dangerous_and_more_so_to_the_careful():
    still = make_agent(AgentConfig(human_actions="still")).source
    _, _, seen = _walked(still, 60)
    tipped = np.zeros((1, WALKER_OBSERVATION), np.float32)
    tipped[0, :3] = [0.8, 0.3, 0.5]
    assert _judged(tipped, 0.1).all()
    assert _judged(seen, 0.01).mean() >= _judged(seen, 0.5).mean()
    assert _judged(seen, 0.0).all() and not _judged(seen, 1.0).any()


def test_a_team_takes_both_by_name():
    agent = make_agent(
        paper_config(danger="experienced", human_actions="trained", intervention="takeover")
    )
    hyper = hyper_for(Method.HITL_FIX, paper_hyper(initial_boundary=0.05, warmup_steps=0))
    state = acting.init_acting(agent, hyper, jax.random.key(0))
    seen = jnp.zeros(WALKER_OBSERVATION).at[:3].set(jnp.array([0.8, 0.3, 0.5]))
    params = behavior(init(agent, jax.random.key(1)))
    _, decision = acting.act(agent, hyper, params, state, seen)
    assert decision.human_action
    own = trained_walker().act((), seen, jax.random.key(0))[1]
    np.testing.assert_allclose(decision.action, own, rtol=1e-6)


@pytest.mark.parametrize("choice", [{"danger": "experienced"}, {"human_actions": "trained"}])
def test_both_are_for_bipedal_walker_alone(choice):
    config = {"observation_size": 3, "human_actions": "still", "indicator": "fall_risk"} | choice
    with pytest.raises(InvalidValue, match="is made for observations of 24 numbers"):
        make_agent(AgentConfig(**config))
