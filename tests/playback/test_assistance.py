"""Who calls the human: each rule raises the alarm where its score reaches its constant."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from paper_team import paper_config, paper_hyper

from hitl_jax.config import Method, hyper_for
from hitl_jax.evaluation.trials import frozen, init_test
from hitl_jax.playback.assistance import _hyper, _rules
from hitl_jax.team import acting
from hitl_jax.team.agent import behavior, init, make_agent

_LEARNED = {"boundary_source": "network", "boundary_learner": "margin"}
_HYPER = hyper_for(
    Method.HITL_AC, paper_hyper(initial_boundary=0.5, boundary_low=0.3, boundary_high=0.7)
)
_NAMES = ["learned boundary", "fixed boundary", "hull angle", "chance"]


def _rules_of(method, **choices):
    agent = make_agent(paper_config(human_actions="trained", release="hysteresis", **choices))
    return {rule.name: rule for rule in _rules(agent, method)}


@pytest.mark.parametrize("name", _NAMES)
@pytest.mark.parametrize("constant", [-0.3, -0.05, 0.05, 0.4])
def test_an_alarm_is_raised_where_the_score_reaches_the_constant(name, constant):
    rule = _rules_of(Method.HITL_AC, indicator="fall_risk", **_LEARNED)[name]
    params = behavior(init(rule.agent, jax.random.key(1)))
    seen = jax.random.normal(jax.random.key(2), (400, 24))
    hyper = _hyper(frozen(_HYPER, human_present=True), rule)
    carry = constant if name == "learned boundary" else abs(constant)

    def alarmed(observation):
        state = init_test(rule.agent, hyper, jnp.float32(carry), jax.random.key(0), jnp.int32(0))
        return acting.act(rule.agent, hyper, params, state, observation)[1].alarmed

    raised = np.asarray(jax.jit(jax.vmap(alarmed))(seen))
    score = np.asarray(jax.jit(jax.vmap(lambda one: rule.score(params, _HYPER, one)))(seen))
    clear = np.abs(score - carry) > 1e-4
    np.testing.assert_array_equal(raised[clear], score[clear] >= carry)
    assert clear.mean() > 0.9


def test_which_rules_there_are():
    assert list(_rules_of(Method.HITL_AC, indicator="fall_risk", **_LEARNED)) == _NAMES
    assert list(_rules_of(Method.HITL_FIX, indicator="fall_risk", **_LEARNED)) == _NAMES[1:]
    assert list(_rules_of(Method.HITL_AC)) == ["fixed boundary", "chance"]


def test_by_all_rules_a_takeover_ends_as_the_human_judges():
    rules = _rules_of(Method.HITL_AC, indicator="fall_risk", **_LEARNED)
    own = make_agent(paper_config()).release
    assert all(rule.agent.release is own for rule in rules.values())


def test_chance_is_uniform_and_tells_nothing_of_the_hull():
    rule = _rules_of(Method.HITL_AC)["chance"]
    seen = jax.random.normal(jax.random.key(0), (4000, 24))
    told = np.asarray(jax.vmap(lambda one: rule.score(None, _HYPER, one))(seen))
    np.testing.assert_allclose(np.quantile(told, [0.1, 0.5, 0.9]), [0.1, 0.5, 0.9], atol=0.03)
    assert abs(np.corrcoef(told, np.abs(seen[:, 0]))[0, 1]) < 0.05
