"""What a user's own module does when it is asked for a choice is one line."""

import signal

import pytest

from hitl_jax.boundary import SOURCES, BoundarySource
from hitl_jax.choices.registry import Registry
from hitl_jax.errors import InvalidValue, WalkerError

_MODULES = {
    "its_attribute": ("import math\nmath.no_such_thing\n", "AttributeError: module 'math' has no"),
    "its_exit": ("import sys\nsys.exit()\n", "its_exit cannot be imported: SystemExit"),
    "its_failure": ("raise RuntimeError('no\\nbattery')\n", "RuntimeError: no"),
    "its_getattr": ("def __getattr__(name):\n    return {}[name]\n", "raised KeyError: 'rule'"),
    "its_lack": ("", "its_lack has no rule"),
}


@pytest.mark.parametrize("name", _MODULES)
def test_what_a_module_raises_is_one_line(name, tmp_path, monkeypatch):
    written, said = _MODULES[name]
    (tmp_path / f"{name}.py").write_text(written)
    monkeypatch.syspath_prepend(tmp_path)
    for _ in range(2):
        with pytest.raises(InvalidValue, match=f"^boundary_source {name}:rule: ") as caught:
            SOURCES.make(f"{name}:rule")
        assert said in str(caught.value) and "\n" not in str(caught.value)


def test_what_a_module_registered_before_it_failed_is_free_again(tmp_path, monkeypatch):
    (tmp_path / "its_names.py").write_text(
        "from hitl_jax.boundary.sources import SOURCES, rule\n"
        "from hitl_jax.learner.algorithms import LEARNERS, ddpg\n"
        "SOURCES.register('mine', 'as rule')(rule)\n"
        "LEARNERS.register('mine', 'as ddpg')(ddpg)\n"
        "raise RuntimeError('no battery')\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    for _ in range(2):
        with pytest.raises(InvalidValue, match="cannot be imported: RuntimeError: no battery"):
            SOURCES.make("its_names:rule")
    assert "mine" not in SOURCES


def _kinds(**more):
    return Registry("odd kind", "odd", lambda value: isinstance(value, BoundarySource), **more)


@pytest.mark.parametrize(
    "error", [RuntimeError("x"), KeyError("x"), AssertionError("x"), OSError("x"), SystemExit("x")]
)
def test_what_a_registered_function_raises_is_one_line(error):
    def make():
        raise error

    kinds = _kinds()
    kinds.register("mine", "fails")(make)
    with pytest.raises(InvalidValue, match=f"^odd mine: raised {type(error).__name__}: '?x'?$"):
        kinds.make("mine")


@pytest.mark.parametrize("error", [OSError("no disk"), WalkerError("a worker died")])
def test_what_says_so_in_one_line_goes_through(error):
    def make():
        raise error

    kinds = _kinds(passes=(OSError,))
    kinds.register("mine", "fails")(make)
    with pytest.raises(type(error), match=f"^{error}$"):
        kinds.make("mine")


def test_an_object_is_named_without_all_that_it_holds():
    kinds = _kinds()
    for given, said in (
        (lambda: (print,) * 9, "odd .*<lambda>: must give an odd kind, gives tuple$"),
        (BoundarySource, "odd BoundarySource: raised TypeError"),
        ({"a": print}, "odd dict: must be one of , or module:name of your own$"),
    ):
        with pytest.raises(InvalidValue, match=f"^{said}"):
            kinds.make(given)
    with pytest.raises(InvalidValue, match=r"^odd BoundarySource: must be one of"):
        kinds.check(BoundarySource(print, print, print))


def test_a_signal_that_ends_the_process_is_nobodys_fault():
    """As Ray's processes, whose handler of SIGTERM exits."""

    def leave(number, frame):
        raise SystemExit(1)

    before = signal.signal(signal.SIGTERM, leave)
    registry = Registry("toy", "toy", lambda value: isinstance(value, int))
    registry.register("slow", "")(lambda: signal.raise_signal(signal.SIGTERM))
    try:
        with pytest.raises(SystemExit):
            registry.make("slow")
    finally:
        signal.signal(signal.SIGTERM, before)
