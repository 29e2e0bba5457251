"""Limited attention: budget, rest, and what is seen through to its end."""

import hypothesis
import hypothesis.strategies as st
import jax.numpy as jnp
import numpy as np
import pytest
from judging import ATTENTIVE, KEY, STILL, bools, judge, quick

from hitl_jax import human
from hitl_jax.human.judgement import HumanParams


class TestAttention:
    @pytest.mark.parametrize(
        ("budget", "rest", "expected"),
        [
            (human.UNLIMITED, 0, "0111101101"),
            (2, 0, "0110000000"),
            (human.UNLIMITED, 2, "0100100100"),
            (2, 2, "0100100000"),
            (0, 0, "0000000000"),
        ],
    )
    def test_by_hand(self, budget, rest, expected):
        params = HumanParams(max_interventions=budget, refractory_steps=rest)
        judged, _ = judge(ATTENTIVE, params, bools("0111101101"))
        np.testing.assert_array_equal(judged, bools(expected))

    def test_agreement_alone_costs_nothing(self):
        params = HumanParams(max_interventions=1, refractory_steps=5)
        dangerous = np.ones(20, bool)
        judged, state = judge(ATTENTIVE, params, dangerous, eager=False)
        assert judged.all()
        assert int(state.used) == 0

    def test_budget_and_rest_outlast_the_episode(self):
        part = ATTENTIVE
        params = HumanParams(max_interventions=2, refractory_steps=3)
        _, state = judge(part, params, bools("001"))
        judged, state = judge(part, params, bools("11111111"), part.begin_episode(state))
        np.testing.assert_array_equal(judged, bools("00010000"))
        judged, _ = judge(part, params, bools("11111111"), part.begin_episode(state))
        assert not judged.any()

    def _take_over(self, params, dangerous, state=None):
        """A takeover lasts while the human sees danger; `notify` is told of it."""
        state = ATTENTIVE.init() if state is None else state
        judged, control = [], False
        for before in dangerous:
            state, after = ATTENTIVE.judge(state, params, STILL, jnp.array(before), KEY)
            began, control = bool(after) and not control, bool(after)
            state = ATTENTIVE.notify(state, params, jnp.array(began), jnp.array(control))
            judged.append(control)
        return judged, state

    def test_an_intervention_under_way_is_seen_through(self):
        # Begun at steps 1 and 8; at rest in the 2 steps after step 3; then the budget is spent.
        params = HumanParams(max_interventions=2, refractory_steps=2)
        judged, state = self._take_over(params, bools("0111010011100011"))
        np.testing.assert_array_equal(judged, bools("0111000011100000"))
        assert int(state.used) == 2

    def test_an_episode_ends_the_intervention(self):
        params = HumanParams(max_interventions=1)
        judged, state = self._take_over(params, bools("11"))
        assert judged == [True, True]
        judged, _ = self._take_over(params, bools("11"), ATTENTIVE.begin_episode(state))
        assert judged == [False, False]

    @quick
    @hypothesis.given(
        st.lists(st.booleans(), min_size=30, max_size=30), st.integers(0, 5), st.integers(0, 6)
    )
    def test_never_more_nor_sooner(self, dangerous, budget, rest):
        params = HumanParams(max_interventions=budget, refractory_steps=rest)
        judged, _ = judge(ATTENTIVE, params, np.array(dangerous))
        steps = np.flatnonzero(judged)
        assert len(steps) <= budget
        assert (np.diff(steps) > rest).all()
        assert not (judged & ~np.array(dangerous)).any()
        if budget and any(dangerous):
            assert steps[0] == dangerous.index(True)
