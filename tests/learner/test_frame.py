"""A packed tick and its layout: each field stands where its name says."""

import jax.numpy as jnp
import numpy as np
import pytest

from hitl_jax.learner.frame import Flags, Frame, Layout, flag_of, flags_of, pack

_LAYOUT = Layout(3, 2)


def _packed():
    frame = Frame(jnp.arange(3.0), jnp.array([10.0, 11.0]), *map(float, range(20, 29)))
    return pack(frame, Flags(*(jnp.asarray(index % 2 == 0) for index in range(6))))


def test_each_field_stands_in_its_column():
    row = np.asarray(_packed())
    assert row.shape == (_LAYOUT.step_width,)
    assert row[_LAYOUT.observation].tolist() == [0.0, 1.0, 2.0]
    assert row[_LAYOUT.action].tolist() == [10.0, 11.0]
    scalars = [row[getattr(_LAYOUT, name)] for name in Frame._fields[2:]]
    assert scalars == list(range(20, 29))
    assert _LAYOUT.width == _LAYOUT.control


def test_flags_come_back_by_name():
    row = _packed()
    flags = flags_of(row, _LAYOUT)
    assert [bool(flag) for flag in flags] == [True, False] * 3
    assert bool(flag_of(row, _LAYOUT, "began")) is False


def test_a_row_without_its_observation_has_the_layout_without_it():
    row, layout = _packed()[_LAYOUT.action.start :], _LAYOUT.without_observation
    assert len(row) == layout.step_width
    assert row[layout.action].tolist() == [10.0, 11.0]
    assert row[layout.reward] == 20.0
    assert bool(flag_of(row, layout, "control"))


def test_no_other_field_is_known():
    with pytest.raises(AttributeError, match="no field 'reward_'"):
        _LAYOUT.reward_  # noqa: B018
