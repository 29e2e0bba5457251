import pathlib
import re
import subprocess
import sys

import pytest

_README = pathlib.Path(__file__).parents[1] / "README.md"
_SNIPPETS = re.findall(r"```python\n(.*?)```", _README.read_text(), flags=re.DOTALL)


@pytest.mark.parametrize("snippet", _SNIPPETS)
def test_snippets_run(snippet):
    exec(compile(snippet, str(_README), "exec"), {})


def test_there_are_snippets():
    assert len(_SNIPPETS) == 3


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
