"""A human who trusts: agrees with every alarm, and gives the controls back as they judge."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hitl_jax.config import AgentConfig, Hyper, Method, hyper_for
from hitl_jax.human import HumanParams, simulated_human
from hitl_jax.human.trusting import trusting
from hitl_jax.team import acting
from hitl_jax.team.agent import behavior, init, make_agent


def _controls(human, angles, delay=0):
    """Whether the human has the controls at each step, the hull's angle being given."""
    config = AgentConfig(intervention="takeover", boundary_source="rule")
    agent = make_agent(config, judge=human)
    given = Hyper(takeover_steps=3, initial_boundary=0.2, human=HumanParams(delay=delay))
    run = hyper_for(Method.HITL_FIX, given)
    params = behavior(init(agent, jax.random.key(0)))
    state = acting.begin_episode(agent, acting.init_acting(agent, run, jax.random.key(1)))
    step = jax.jit(lambda state, seen: acting.act(agent, run, params, state, seen))
    held = []
    for angle in angles:
        state, decision = step(state, jnp.zeros(24).at[0].set(angle))
        held.append(bool(decision.control))
    return np.array(held)


_ANGLES = [0.0, 0.3, 0.0, 0.0, 0.0, 0.0, 0.5, 0.5, 0.5, 0.5, 0.5, 0.0, 0.0]


def test_every_alarm_is_followed_and_the_judgement_ends_a_takeover():
    """0.3 rad raises an alarm, but looks dangerous to nobody; 0.5 rad does."""
    own = simulated_human("threshold")
    judged = _controls(own, _ANGLES)
    assert judged.nonzero()[0].tolist() == [6, 7, 8, 9, 10]
    assert _controls(trusting(own), _ANGLES).nonzero()[0].tolist() == [1, 2, 3, 6, 7, 8, 9, 10]


def test_who_is_slow_follows_at_once_and_gives_back_late():
    held = _controls(trusting(simulated_human("threshold")), _ANGLES, delay=2)
    assert held.nonzero()[0].tolist() == [1, 2, 3, 6, 7, 8, 9, 10, 11, 12]


def test_begun_anew_nobody_has_the_controls():
    human = trusting(simulated_human("threshold"))
    state = human.notify(human.init(), HumanParams(), jnp.ones((), bool), jnp.ones((), bool))
    given = HumanParams(), jnp.zeros(24), jnp.zeros((), bool), jax.random.key(0)
    assert not bool(human.judge(state, *given)[1])
    assert bool(human.judge(human.begin_episode(state), *given)[1])


@pytest.mark.parametrize("part", ["observation_size", "options"])
def test_it_is_made_for_what_its_human_was_made_for(part):
    human = simulated_human("experienced")
    assert getattr(trusting(human), part) == getattr(human, part)
