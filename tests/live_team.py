"""A small session for the tests of the live page."""

import functools

from hitl_jax.agent import make_agent
from hitl_jax.config import AgentConfig, Hyper, Method, hyper_for
from hitl_jax.live import person
from hitl_jax.live.session import Setup
from hitl_jax.runs import LoopConfig

HYPER = hyper_for(
    Method.HITL_AC, Hyper(warmup_steps=64, initial_boundary=0.1, delta_minus=0.01, delta_plus=0.01)
)


@functools.cache
def agent_of(intervention):
    """The same object each time, so that what it compiles is shared."""
    config = AgentConfig(
        learner="td3",
        hidden_sizes=(16,),
        batch_size=16,
        boundary_hidden_sizes=(8,),
        boundary_batch_size=8,
        intervention=intervention,
    )
    return make_agent(config, judge=person.judge(), source=person.hands(4))


def setup_of(intervention="takeover", **changes):
    """Of a session with a person; a replay of 512 frames."""
    setup = Setup(
        agent=agent_of(intervention),
        hyper=HYPER,
        loop=LoopConfig(capacity=512),
        method=Method.HITL_AC,
        seed=0,
        with_person=True,
        learns=True,
    )
    return setup._replace(**changes)
