"""Training episodes without action noise, and without the human."""

import compiled
import jax
import jax.numpy as jnp
from paper_team import paper_config, paper_hyper

from hitl_jax.config import Method, hyper_for
from hitl_jax.evaluation import trials
from hitl_jax.team import acting
from hitl_jax.team import agent as agents

_UPRIGHT = jnp.zeros(24)
_TILTED = _UPRIGHT.at[0].set(0.9)


def test_every_so_many_episodes_are_noise_free():
    agent = agents.make_agent(paper_config())
    hyper = hyper_for(Method.SRL, paper_hyper(noise_free_every=3, warmup_steps=0))
    params = agents.behavior(compiled.init(agent, jax.random.key(1)))
    greedy = agent.learner.actor.apply(params.actor, _UPRIGHT)
    state = acting.init_acting(agent, hyper, jax.random.key(0))
    noise_free = []
    for _ in range(7):
        state = acting.begin_episode(agent, state)
        state, decision = acting.act(agent, hyper, params, state, _UPRIGHT)
        noise_free.append(bool(jnp.all(decision.action == greedy)))
    assert noise_free == [False, False, True, False, False, True, False]


def test_a_test_has_no_noise_however_the_noise_of_training_fades():
    agent = agents.make_agent(paper_config())
    params = agents.behavior(compiled.init(agent, jax.random.key(1)))
    greedy = agent.learner.actor.apply(params.actor, _UPRIGHT)
    hyper = paper_hyper(noise_free_every=0, warmup_steps=0, noise_steps=10, final_noise=0.2)
    trained = hyper_for(Method.SRL, hyper)
    for each, noisy in ((trained, True), (trials.frozen(trained, human_present=False), False)):
        state = acting.begin_episode(agent, acting.init_acting(agent, each, jax.random.key(0)))
        for _ in range(12):
            state, decision = acting.act(agent, each, params, state, _UPRIGHT)
            assert bool(jnp.any(decision.action != greedy)) == noisy


def test_every_so_many_episodes_are_walked_without_the_human_but_no_tests():
    agent = agents.make_agent(paper_config(intervention="takeover"))
    params = agents.behavior(compiled.init(agent, jax.random.key(1)))
    hyper = hyper_for(Method.HITL_FIX, paper_hyper(unattended_every=2))
    for each, expected in (
        (hyper, [True, False, True, False]),
        (trials.frozen(hyper, human_present=True), [True] * 4),
    ):
        state, attended = acting.init_acting(agent, each, jax.random.key(0)), []
        for _ in expected:
            state = acting.begin_episode(agent, state)
            state, decision = acting.act(agent, each, params, state, _TILTED)
            assert decision.alarmed == decision.control == (decision.boundary_reward != 0.0)
            attended.append(bool(decision.control))
        assert attended == expected
