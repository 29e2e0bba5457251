import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from pages import ROOT, python_in, run

from hitl_jax.human.indicator import hull_angle, hull_angular_velocity

README = (ROOT / "README.md").read_text()


def test_the_program_runs_and_means_what_it_says(tmp_path):
    _, code = python_in(README)
    made = run(code, tmp_path)
    seen = jnp.asarray(np.random.default_rng(0).normal(size=24), jnp.float32)
    expected = hull_angle(seen) + 0.1 * hull_angular_velocity(seen)
    np.testing.assert_allclose(made["leaning"](seen), expected, rtol=1e-6)
    assert made["agent"].indicator is made["leaning"]
    # Tilted all the time: nothing is said for ten steps, then in some seven of ten.
    human, state, said = made["agent"].human, made["agent"].human.init(), []
    judge, tilted = jax.jit(human.judge), jnp.zeros(24).at[0].set(0.6)
    for key in jax.random.split(jax.random.key(0), 210):
        state, dangerous = judge(state, made["hyper"].human, tilted, jnp.zeros((), bool), key)
        said.append(bool(dangerous))
    assert not any(said[:10]) and 0.6 < np.mean(said[10:]) < 0.8
    assert sorted(one.run.spec.seed for one in made["ended"]) in ([0], [1], [0, 1])


def test_the_task_of_ones_own_is_the_one_that_is_tested():
    code, _ = python_in(README)
    assert (ROOT / "tests" / "pendulum_task.py").read_text().endswith(f'"""\n\n{code}')
    written = [line for line in code.splitlines() if line]
    assert len(written) < 15


def test_the_two_commands_stand_as_they_are_known():
    first, second = "pip install -e . && python -m experiments.seed_sweep", "&& pytest"
    assert f"    {first}\n" in README and f'    pip install -e ".[test]" {second}\n' in README


def test_importing_the_package_is_quick_and_silent():
    code = (
        "import sys, hitl_jax; names = dir(hitl_jax);"
        "assert 'jax' not in sys.modules and 'brax' not in sys.modules;"
        "assert hitl_jax.Method.SRL == 'srl' and 'update' in names;"
        "assert not any(name.startswith('brax') for name in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == done.stderr == ""


def test_unknown_names_are_refused():
    import hitl_jax

    with pytest.raises(AttributeError, match="nonsense"):
        hitl_jax.nonsense  # noqa: B018
