import jax
import numpy as np
import pytest

from hitl_jax.keys import make_key

_DRAWS = {
    "normal": lambda key: jax.random.normal(key, (3, 4)),
    "uniform": lambda key: jax.random.uniform(key, (5,), minval=-1.0),
    "scalar": lambda key: jax.random.normal(key, ()),
    "randint": lambda key: jax.random.randint(key, (64,), 0, 1000),
    "bernoulli": lambda key: jax.random.bernoulli(key, 0.3, (64,)),
    "split": lambda key: jax.random.key_data(jax.random.split(key, (2, 3))),
    "fold_in": lambda key: jax.random.key_data(jax.random.fold_in(key, 2**32 - 1)),
    "after": lambda key: jax.random.normal(jax.random.split(jax.random.fold_in(key, 7))[1]),
}


@pytest.mark.parametrize("name", _DRAWS)
@pytest.mark.parametrize("seed", [0, 1, 2**32 - 1])
def test_draws_what_jax_draws(name, seed):
    draw = _DRAWS[name]
    np.testing.assert_array_equal(draw(make_key(seed)), draw(jax.random.key(seed)))


@pytest.mark.parametrize("name", _DRAWS)
def test_draws_the_same_for_many_keys_at_once(name):
    draw = jax.jit(jax.vmap(_DRAWS[name]))
    ours, theirs = (draw(jax.random.split(key, 9)) for key in (make_key(3), jax.random.key(3)))
    np.testing.assert_array_equal(ours, theirs)


def test_other_widths_are_refused():
    with pytest.raises(ValueError, match="draws of 8 bits: must be 32"):
        jax.random.bits(make_key(0), (4,), "uint8")
