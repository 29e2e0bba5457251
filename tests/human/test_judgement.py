import dataclasses
import math

import chex
import hypothesis
import hypothesis.strategies as st
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from judging import (
    DELAYED,
    FALSE,
    KEY,
    SIMULATED,
    bools,
    judge,
    observation,
    outcome,
    quick,
    run_part,
)

from hitl_jax import human
from hitl_jax.human.judgement import HumanParams

AT_ONCE = HumanParams(delay=0)


class TestDanger:
    @pytest.mark.parametrize(
        ("angle", "expected"), [(0.5, True), (-0.5, True), (0.4, False), (-0.4, False)]
    )
    def test_threshold_takes_the_absolute_angle(self, angle, expected):
        part = human.threshold()
        params = HumanParams(tolerance=0.45)
        # The velocity and what was judged before do not matter.
        for before in (False, True):
            seen = observation(angle, velocity=9.0)
            _, dangerous = part.judge(part.init(), params, seen, jnp.array(before), KEY)
            assert bool(dangerous) is expected

    def test_threshold_includes_the_tolerance(self):
        part = human.threshold()
        seen = observation(0.5)
        assert bool(part.judge(part.init(), HumanParams(tolerance=0.5), seen, FALSE, KEY)[1])

    @pytest.mark.parametrize(
        ("angle", "velocity", "expected"),
        [
            (0.3, 1.0, True),  # 0.3 + 0.2 · 1 = 0.5 ≥ 0.45
            (0.5, -1.0, False),  # 0.5 − 0.2 = 0.3: on its way back
            (-0.3, -1.0, True),
            (0.4, 0.0, False),
            (0.0, 3.0, True),
        ],
    )
    def test_predictive_looks_ahead(self, angle, velocity, expected):
        part = human.predictive()
        params = HumanParams(tolerance=0.45, horizon=0.2)
        _, dangerous = part.judge(part.init(), params, observation(angle, velocity), FALSE, KEY)
        assert bool(dangerous) is expected

    @quick
    @hypothesis.given(st.floats(-2, 2, width=32), st.floats(-5, 5, width=32))
    def test_no_horizon_is_the_threshold(self, angle, velocity):
        seen = observation(angle, velocity)
        params = HumanParams(horizon=0.0)
        answers = [
            bool(part.judge(part.init(), params, seen, FALSE, KEY)[1])
            for part in (human.threshold(), human.predictive())
        ]
        assert answers[0] == answers[1]


class TestDelay:
    @pytest.mark.parametrize(
        ("delay", "expected"),
        [(0, "1011000"), (1, "0101100"), (2, "0010110"), (4, "0000101"), (9, "0000000")],
    )
    def test_by_hand(self, delay, expected):
        judged, _ = judge(DELAYED, HumanParams(delay=delay), bools("1011000"))
        np.testing.assert_array_equal(judged, bools(expected))

    def test_an_episode_forgets(self):
        part, params = human.delayed(4), HumanParams(delay=2)
        _, state = judge(part, params, bools("111"))
        judged, _ = judge(part, params, bools("100"), part.begin_episode(state))
        np.testing.assert_array_equal(judged, bools("001"))

    @quick
    @hypothesis.given(st.lists(st.booleans(), min_size=12, max_size=12), st.integers(0, 9))
    def test_is_a_shift(self, dangerous, delay):
        judged, _ = judge(DELAYED, HumanParams(delay=delay), np.array(dangerous))
        np.testing.assert_array_equal(judged, ([False] * delay + dangerous)[:12])

    def test_a_longer_delay_is_cut_down(self):
        judged, _ = judge(human.delayed(2), HumanParams(delay=5), bools("10000"))
        np.testing.assert_array_equal(judged, bools("00100"))

    def test_a_negative_memory_is_refused(self):
        with pytest.raises(ValueError, match="max_delay -1"):
            human.delayed(-1)


class TestMistakesAndLapses:
    N = 20_000

    @pytest.mark.parametrize("rate", [0.05, 0.5, 0.9])
    @pytest.mark.parametrize("dangerous", [False, True])
    def test_rate_of_mistakes(self, rate, dangerous):
        judged, _ = judge(
            human.mistaken(), HumanParams(mistake_rate=rate), np.full(self.N, dangerous)
        )
        flipped = judged != dangerous
        sigma = math.sqrt(rate * (1 - rate) / self.N)
        assert abs(flipped.mean() - rate) < 4 * sigma
        # One step says nothing about the next.
        assert abs(np.corrcoef(flipped[1:], flipped[:-1])[0, 1]) < 4 / math.sqrt(self.N)

    @pytest.mark.parametrize("rate", [0.05, 0.5])
    def test_rate_of_lapses(self, rate):
        params = HumanParams(lapse_rate=rate)
        judged, _ = judge(human.lapsing(), params, np.ones(self.N, bool))
        assert abs((1 - judged.mean()) - rate) < 4 * math.sqrt(rate * (1 - rate) / self.N)
        judged, _ = judge(human.lapsing(), params, np.zeros(self.N, bool))
        assert not judged.any()

    def test_the_ends_are_exact(self):
        dangerous = bools("0110" * 50)
        for rate, expected in ((0.0, dangerous), (1.0, ~dangerous)):
            judged, _ = judge(human.mistaken(), HumanParams(mistake_rate=rate), dangerous)
            np.testing.assert_array_equal(judged, expected)
        for rate, expected in ((0.0, dangerous), (1.0, np.zeros(200, bool))):
            judged, _ = judge(human.lapsing(), HumanParams(lapse_rate=rate), dangerous)
            np.testing.assert_array_equal(judged, expected)

    def test_mistakes_and_lapses_do_not_share_their_draws(self):
        """P(dangerous | safe) = ε (1 − m) only if they are independent."""
        rate, lapse = 0.3, 0.4
        params = HumanParams(mistake_rate=rate, lapse_rate=lapse)
        part = human.chain(human.mistaken(), human.lapsing())
        judged, _ = judge(part, params, np.zeros(self.N, bool))
        expected = rate * (1 - lapse)
        assert abs(judged.mean() - expected) < 4 * math.sqrt(expected * (1 - expected) / self.N)


class TestRecorded:
    def test_plays_on_over_episodes_and_ends_safe(self):
        part = human.recorded(bools("10110"))
        judged, state = judge(part, HumanParams(), np.zeros(3, bool))
        np.testing.assert_array_equal(judged, bools("101"))
        judged, state = judge(part, HumanParams(), np.ones(6, bool), part.begin_episode(state))
        np.testing.assert_array_equal(judged, bools("100000"))
        assert int(state) == 5

    def test_an_empty_log_is_safe(self):
        judged, _ = judge(human.recorded(np.zeros(0, bool)), HumanParams(), np.ones(3, bool))
        assert not judged.any()

    def test_a_log_for_each_run(self):
        logs = jnp.array([bools("1100"), bools("0011")])
        judged = jax.vmap(lambda log: run_part(human.recorded(log), HumanParams(), KEY, 4))(logs)
        np.testing.assert_array_equal(judged, logs)

    @pytest.mark.parametrize("log", [np.zeros(3), np.zeros((2, 3), bool), np.array(True)])
    def test_other_logs_are_refused(self, log):
        with pytest.raises(ValueError, match=r"must be bool\[T\]"):
            human.recorded(log)


class TestComposition:
    def test_the_order(self):
        """Danger, delay, mistakes, lapses, attention: each order but this gives another answer."""
        log = human.recorded(bools("100000"))
        tail = (human.mistaken(), human.lapsing(), human.attentive())
        part = human.chain(log, human.delayed(4), *tail)
        # Delay before mistakes: the delayed "100" is 0010, flipped 1101. The other way round, the
        # first steps of an episode would be safe: 0001.
        params = HumanParams(delay=2, mistake_rate=1.0)
        np.testing.assert_array_equal(run_part(part, params, KEY, 4), bools("1101"))
        # Lapses after mistakes: never danger. The other way round: always.
        params = HumanParams(delay=2, mistake_rate=1.0, lapse_rate=1.0)
        assert not run_part(part, params, KEY, 4).any()
        # Attention after mistakes: patience spent stays spent.
        params = AT_ONCE.replace(mistake_rate=1.0, max_interventions=0)
        assert not run_part(part, params, KEY, 4).any()

    @pytest.mark.parametrize(
        ("params", "expected"),
        [
            (AT_ONCE, "01100110"),
            (HumanParams(delay=2), "00011001"),
            (AT_ONCE.replace(mistake_rate=1.0), "10011001"),
            (HumanParams(delay=2, mistake_rate=1.0), "11100110"),
            (AT_ONCE.replace(lapse_rate=1.0), "00000000"),
            (AT_ONCE.replace(mistake_rate=1.0, lapse_rate=1.0), "00000000"),
            (AT_ONCE.replace(mistake_rate=1.0, max_interventions=0), "00000000"),
            (AT_ONCE.replace(tolerance=0.65), "00100010"),
        ],
    )
    def test_the_simulated_human_by_hand(self, params, expected):
        angles = jnp.array([0.0, 0.6, -0.7, 0.1, 0.0, 0.6, -0.7, 0.1])
        np.testing.assert_array_equal(run_part(SIMULATED, params, KEY, 8, angles), bools(expected))

    def test_is_the_chain_of_its_parts(self):
        assert len(human.simulated_human().init()) == 5
        params = HumanParams(mistake_rate=0.3, lapse_rate=0.3, delay=3)
        parts = (human.predictive(), human.delayed(8), human.mistaken(), human.lapsing())
        angles = jax.random.normal(KEY, (200,))
        ours = run_part(human.simulated_human("predictive", 8), params, KEY, 200, angles)
        np.testing.assert_array_equal(
            ours, run_part(human.chain(*parts, human.attentive()), params, KEY, 200, angles)
        )

    def test_a_chain_in_a_chain_and_a_part_alone(self):
        angles = jnp.array([0.0, 0.6, -0.7, 0.1])
        alone = run_part(human.threshold(), HumanParams(), KEY, 4, angles)
        inner = human.chain(human.threshold(), human.delayed(2))
        nested = run_part(
            human.chain(inner, human.attentive()), HumanParams(delay=1), KEY, 4, angles
        )
        np.testing.assert_array_equal(alone, bools("0110"))
        np.testing.assert_array_equal(nested, bools("0011"))

    def test_the_chain_passes_on_what_happened(self):
        part = human.chain(human.threshold(), human.attentive())
        params = HumanParams(max_interventions=1)
        state, dangerous = part.judge(part.init(), params, observation(1.0), FALSE, KEY)
        assert bool(dangerous)
        state = part.notify(state, params, jnp.array(True), jnp.array(True))
        # Still in control: seen through. Then spent, in the next episode too.
        assert bool(part.judge(state, params, observation(1.0), FALSE, KEY)[1])
        state = part.begin_episode(state)
        assert not bool(part.judge(state, params, observation(1.0), FALSE, KEY)[1])

    def test_an_unknown_danger_is_refused(self):
        with pytest.raises(ValueError, match="danger outcome: must be one of threshold, predict"):
            human.simulated_human("outcome")


class HumanVariants(chex.TestCase):
    @chex.variants(with_jit=True, without_jit=True)
    def test_alike_however_it_is_compiled(self):
        """Many humans in one program judge as each does alone, and no parameter compiles again."""
        num_steps = 12
        part = human.simulated_human("predictive", max_delay=8)
        humans = [
            AT_ONCE,
            HumanParams(tolerance=0.2, delay=3),
            HumanParams(tolerance=0.9, horizon=1.0, delay=8),
            AT_ONCE.replace(tolerance=0.1, mistake_rate=0.2, lapse_rate=0.3),
            AT_ONCE.replace(tolerance=0.1, max_interventions=2, refractory_steps=4),
        ]
        stacked = jax.tree.map(lambda *leaves: jnp.array(leaves), *humans)
        keys = jax.random.split(KEY, len(humans))
        angles = jax.random.normal(jax.random.key(1), (len(humans), num_steps))

        def step(state, params, angle, key):
            state, dangerous = part.judge(state, params, observation(angle, 0.5), FALSE, key)
            return part.notify(state, params, dangerous), dangerous

        step = chex.assert_max_traces(step, 1) if self.variant.type.name == "WITH_JIT" else step
        batched = self.variant(jax.vmap(step))
        states = jax.vmap(lambda _: part.init())(jnp.arange(len(humans)))
        together = []
        for t in range(num_steps):
            step_keys = jax.vmap(jax.random.fold_in, (0, None))(keys, t)
            states, dangerous = batched(states, stacked, angles[:, t], step_keys)
            together.append(dangerous)
        together = np.array(together)

        for index, params in enumerate(humans):
            # Alone, in a scan, with Python numbers for parameters.
            expected = _alone(part, params, angles[index], keys[index])
            np.testing.assert_array_equal(together[:, index], expected)
        assert 0 < together.mean() < 1


def _alone(part, params, angles, key):
    def step(state, inputs):
        t, angle = inputs
        seen = observation(angle, 0.5)
        state, dangerous = part.judge(state, params, seen, FALSE, jax.random.fold_in(key, t))
        return part.notify(state, params, dangerous), dangerous

    return jax.lax.scan(step, part.init(), (jnp.arange(len(angles)), angles))[1]


class TestParams:
    @pytest.mark.parametrize(("params", "late"), [(HumanParams(), 10), (AT_ONCE, 0)])
    def test_the_defaults_are_right_after_a_reaction_time(self, params, late):
        human.validate_human_params(params)
        angles = jax.random.normal(KEY, (200,))
        judged = run_part(SIMULATED, params, KEY, 200, angles)
        np.testing.assert_array_equal(judged[late:], np.abs(angles)[: 200 - late] >= 0.45)
        assert not judged[:late].any()

    @pytest.mark.parametrize(
        ("name", "value"),
        [
            ("tolerance", 0.0),
            ("tolerance", math.nan),
            ("tolerance", math.inf),
            ("tolerance", "wide"),
            ("horizon", -0.1),
            ("delay", -1),
            ("delay", 33),
            ("delay", 1.5),
            ("delay", True),
            ("mistake_rate", -0.1),
            ("mistake_rate", 1.1),
            ("lapse_rate", math.nan),
            ("lapse_rate", 2),
            ("max_interventions", -1),
            ("max_interventions", 2**31),
            ("refractory_steps", -3),
        ],
    )
    def test_bad_values_are_refused_in_one_line(self, name, value):
        params = dataclasses.replace(HumanParams(), **{name: value})
        with pytest.raises(ValueError, match=f"^human.{name} .*: must be ") as caught:
            human.validate_human_params(params)
        assert "\n" not in str(caught.value)

    def test_the_longest_delay_is_the_humans(self):
        human.validate_human_params(HumanParams(delay=40), max_delay=40)
        with pytest.raises(ValueError, match="from 0 to 20"):
            human.validate_human_params(HumanParams(delay=40), max_delay=20)


class TestOutcome:
    def test_by_hand(self):
        # The fifth step ends in a fall: of 3 steps from s_2, s_3 or s_4, one is the fifth.
        fell = bools("00001")
        np.testing.assert_array_equal(human.outcome_dangerous(fell, 3), bools("00111"))
        np.testing.assert_array_equal(human.outcome_dangerous(fell, 1), fell)
        np.testing.assert_array_equal(human.outcome_dangerous(fell, 0), bools("00000"))
        np.testing.assert_array_equal(human.outcome_dangerous(fell, 99), bools("11111"))
        assert not human.outcome_dangerous(np.zeros(5, bool), 3).any()

    @quick
    @hypothesis.given(st.lists(st.booleans(), min_size=9, max_size=9), st.integers(0, 12))
    def test_is_any_fall_in_the_window(self, fell, k):
        expected = [any(fell[t : t + k]) for t in range(9)]
        np.testing.assert_array_equal(human.outcome_dangerous(np.array(fell), k), expected)
        np.testing.assert_array_equal(outcome(jnp.array(fell), k), expected)
