"""Keys and draws do not depend on the user's JAX configuration."""

import functools
import subprocess
import sys

import jax
import numpy as np
import pytest

from hitl_jax.xla.threefry import make_key, wrap_key

_DRAW = """
import jax
from hitl_jax.xla.threefry import make_key, wrap_key
key = wrap_key(jax.random.key_data(make_key(7)))
print(jax.random.normal(jax.random.split(jax.random.fold_in(key, 3))[1], (), "float32"))
"""


@pytest.mark.parametrize("seed", [0, 1, 2**31, 2**32 - 1])
def test_a_key_is_its_seed(seed):
    words = jax.random.key_data(make_key(seed))
    np.testing.assert_array_equal(words, np.array([0, seed], np.uint32))
    np.testing.assert_array_equal(jax.random.key_data(wrap_key(words)), words)


@functools.cache
def _drawn(first):
    return subprocess.run(
        [sys.executable, "-c", first + _DRAW], capture_output=True, text=True, check=True
    ).stdout


@pytest.mark.parametrize(
    "setting",
    ["jax_default_prng_impl='rbg'", "jax_enable_x64=True", "jax_numpy_rank_promotion='raise'"],
)
def test_draws_do_not_depend_on_the_users_configuration(setting):
    name, value = setting.split("=")
    assert _drawn(f"import jax; jax.config.update('{name}', {value})") == _drawn("")
