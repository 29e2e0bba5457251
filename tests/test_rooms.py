"""The rooms of `hitl_jax`, and who may import whom; docs/architecture.md says why."""

import ast
import pathlib
import subprocess
import sys

import pytest

_PACKAGE = pathlib.Path(__file__).parents[1] / "hitl_jax"
_ROOMS = (
    *("types", "errors", "choices", "xla", "results", "analysis"),
    *("learner", "risk", "human", "tasks", "boundary", "arbiter", "config", "team"),
    *("walker", "envs", "training", "evaluation", "sweep"),
    *(
        "console",
        "studies",
        "playback",
        "reports",
        "agreement",
        "live",
        "exchange",
        "benchmarks",
        "faults",
        "commands",
    ),
)
"""Each may import those before it."""


def _imported(path):
    """The modules of ours that a file imports, also inside of its functions."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (name.name for name in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: a relative import"
            for name in node.names:
                inner = f"{node.module}.{name.name}"
                yield inner if inner in _MODULES else node.module


def _modules():
    for path in sorted(_PACKAGE.rglob("*.py")):
        parts = path.relative_to(_PACKAGE.parent).with_suffix("").parts
        yield ".".join(parts).removesuffix(".__init__"), path


_MODULES = dict(_modules())
_IMPORTS = {
    module: sorted({name for name in _imported(path) if name in _MODULES} - {module, "hitl_jax"})
    for module, path in _MODULES.items()
}


def _room(module):
    return module.split(".")[1]


def test_the_top_holds_what_all_rooms_share_and_nothing_else():
    top = {path.name for path in _PACKAGE.glob("*.py")}
    assert top == {"__init__.py", "__main__.py", "config.py", "errors.py", "types.py"}


def test_every_room_is_in_the_order():
    rooms = {_room(module) for module in _MODULES if "." in module} - {"__main__"}
    assert rooms == set(_ROOMS)


@pytest.mark.parametrize("room", _ROOMS)
def test_imports_go_one_way(room):
    allowed = {*_ROOMS[: _ROOMS.index(room) + 1]}
    if room == "analysis":
        allowed = {"types", "errors", "results", "analysis"}
    wrong = [
        f"{module} imports {name}"
        for module, names in _IMPORTS.items()
        if "." in module and _room(module) == room
        for name in names
        if _room(name) not in allowed
    ]
    assert not wrong


def test_no_module_imports_itself_through_others():
    done, path = set(), []

    def visit(module):
        if module in path:
            raise AssertionError(" -> ".join([*path[path.index(module) :], module]))
        if module in done:
            return
        path.append(module)
        for name in _IMPORTS[module]:
            visit(name)
        path.pop()
        done.add(module)

    for module in _MODULES:
        visit(module)


@pytest.mark.parametrize("room", ["results", "analysis"])
def test_results_are_read_and_drawn_without_jax(room):
    code = (
        "import importlib, pkgutil, sys\n"
        f"import hitl_jax.{room} as room\n"
        "for module in pkgutil.walk_packages(room.__path__, f'{room.__name__}.'):\n"
        "    importlib.import_module(module.name)\n"
        "assert 'jax' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
