import jax.numpy as jnp
import numpy as np
import pytest

from hitl_jax import arbiter


def _play(intervention, alarms, dangers, keeps=None, takeover_steps=3):
    """u_t, began, human_action and human_reset over a sequence."""
    chosen = arbiter.INTERVENTIONS.make(intervention)
    state = chosen.init()
    rulings = []
    for alarmed, dangerous, keep in zip(alarms, dangers, keeps or dangers, strict=True):
        flags = (jnp.array(flag, bool) for flag in (alarmed, dangerous, keep))
        state, ruling = chosen.rule(state, arbiter.Situation(*flags, takeover_steps, {}))
        rulings.append(ruling)
    fields = ("control", "began", "human_action", "human_reset")
    return {name: [int(getattr(ruling, name)) for ruling in rulings] for name in fields}


def test_reset_needs_alarm_and_agreement():
    played = _play("reset", [1, 1, 0, 1], [0, 1, 1, 1])
    assert played["control"] == played["began"] == played["human_reset"] == [0, 1, 0, 1]
    assert played["human_action"] == [0, 0, 0, 0]


def test_takeover_lasts_until_safe_and_at_least_its_minimum():
    #            begins, held by the minimum of 3, then by danger, then safe
    played = _play("takeover", [1, 0, 0, 0, 0, 0], [1, 0, 0, 1, 0, 1])
    assert played["control"] == played["human_action"] == [1, 1, 1, 1, 0, 0]
    assert played["began"] == [1, 0, 0, 0, 0, 0]
    assert played["human_reset"] == [0] * 6


def test_takeover_can_outlast_the_danger():
    played = _play("takeover", [1, 0, 0, 0, 0], [1, 0, 0, 0, 0], keeps=[0, 0, 0, 1, 0])
    assert played["control"] == [1, 1, 1, 1, 0]
    #            an alarm without danger begins nothing, whatever would keep it
    assert _play("takeover", [1, 1], [0, 0], keeps=[1, 1])["control"] == [0, 0]


def test_penalty_changes_nothing_but_the_reward():
    played = _play("penalty", [1, 1, 0, 1], [1, 1, 1, 1])
    assert played["control"] == [1, 1, 0, 1]
    assert played["began"] == [1, 0, 0, 1]
    assert played["human_action"] == played["human_reset"] == [0] * 4


def test_unknown_intervention():
    with pytest.raises(ValueError, match="reset, takeover, penalty"):
        _play("shout", [1], [1])


@pytest.mark.parametrize(
    ("schedule", "expected"),
    # Rewards 1, 1, 1; u = (1, 1, 0); the episode ends with the third step; feedback -20.
    [
        ("step", [-19.0, -19.0, 1.0]),
        ("onset", [-19.0, 1.0, 1.0]),
        ("episode", [1.0, 1.0, -19.0]),
    ],
)
def test_equation_7(schedule, expected):
    control = np.array([True, True, False])
    began = np.array([True, False, False])
    intervened = np.array([True, True, True])
    ended = np.array([False, False, True])
    given = arbiter.shaped_reward(np.ones(3), control, -20.0, schedule, began, ended, intervened)
    np.testing.assert_array_equal(given, expected)
