"""Which steps are told from those of a test: with action noise, or at random in the warm-up."""

import compiled
import jax
import jax.numpy as jnp
import pytest
from paper_team import paper_config, paper_hyper

from hitl_jax.config import Method, hyper_for
from hitl_jax.team import acting, packed_decision
from hitl_jax.team import agent as agents


def _told(**hyper):
    """`Frame.explores` of the first step of five episodes, as the replay gets it."""
    agent = agents.make_agent(paper_config())
    run = hyper_for(Method.SRL, paper_hyper(**hyper))
    params = agents.behavior(compiled.init(agent, jax.random.key(1)))
    state = acting.init_acting(agent, run, jax.random.key(0))
    step = jax.jit(
        lambda state, live: packed_decision.act_or_begin(
            agent, run, params, state, jnp.zeros(24), live
        )
    )
    told = []
    for _ in range(5):
        state, _reset = step(state, jnp.zeros((), bool))
        state, packed = step(state, jnp.ones((), bool))
        told.append(int(packed[agent.layout.explores]))
    return told


@pytest.mark.parametrize(
    ("hyper", "told"),
    [
        ({"noise_free_every": 2, "warmup_steps": 0}, [1, 0, 1, 0, 1]),
        ({"noise_free_every": 2, "warmup_steps": 3}, [1, 1, 1, 0, 1]),
        ({"noise_free_every": 0, "warmup_steps": 3}, [0, 0, 0, 0, 0]),
        ({"noise_free_every": 1, "warmup_steps": 0}, [0, 0, 0, 0, 0]),
        ({"noise_free_every": 2, "warmup_steps": 0, "noise_steps": 2}, [1, 0, 0, 0, 0]),
        ({"noise_free_every": 2, "warmup_steps": 0, "noise_steps": 3}, [1, 0, 1, 0, 0]),
        (
            {"noise_free_every": 2, "warmup_steps": 0, "noise_steps": 2, "final_noise": 0.1},
            [1, 0, 1, 0, 1],
        ),
        ({"noise_free_every": 2, "warmup_steps": 3, "exploration_noise": 0.0}, [1, 1, 1, 0, 0]),
    ],
)
def test_noise_and_the_warm_up_are_told_where_some_episodes_have_none(hyper, told):
    assert _told(**hyper) == told
