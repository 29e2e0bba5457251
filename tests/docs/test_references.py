"""What the pages refer to exists: files, functions, headings."""

import ast
import functools
import re

import pytest
from pages import PAGES, ROOT, anchor, headings

import hitl_jax

_PACKAGE = ROOT / "hitl_jax"
_ROOMS = {path.stem for path in _PACKAGE.iterdir()}

_FILES = re.compile(r"(?<![\w./*<-])((?:[\w.-]+/)*[\w.-]+\.(?:py|js|html|css|toml|cff|md))\b")
_DOTTED = re.compile(r"\bhitl_jax((?:\.\w+)+)")
_SHORT = re.compile(r"`(\w+(?:\.(?!json|log|md|npz|py\b)\w+)+)[(`]")
_LINKS = re.compile(r"\]\(([^)\s]+)\)")
_MADE_UP = {"my_envs.py"}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_files_exist(page):
    text = re.sub(r"https?://\S+", "", page.read_text())
    wanted = set(_FILES.findall(text)) - _MADE_UP
    places = (page.parent, ROOT, _PACKAGE)
    missing = [name for name in wanted if not any((place / name).exists() for place in places)]
    results = {"summary.md", "participants.md"}  # Files that a sweep writes, not ours.
    assert not sorted(set(missing) - results)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_names_exist(page):
    text = page.read_text()
    names = {name[1:] for name in _DOTTED.findall(text)}
    names |= {name for name in _SHORT.findall(text) if name.partition(".")[0] in _ROOMS}
    assert not sorted(name for name in names if not _exists(name.split(".")))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_links_lead_somewhere(page):
    for link in _LINKS.findall(page.read_text()):
        if link.startswith(("http:", "https:")):
            continue
        name, _, place = link.partition("#")
        target = page.parent / name if name else page
        assert target.exists(), link
        assert not place or place in {anchor(each) for each in headings(target)}, link


def _exists(names):
    """Whether a dotted name below `hitl_jax` is a module or stands in one; nothing is imported."""
    path, left = _PACKAGE, list(names)
    while left and (path / left[0]).is_dir():
        path /= left.pop(0)
    if left and (path / f"{left[0]}.py").exists():
        path /= f"{left.pop(0)}.py"
    elif path == _PACKAGE:
        return len(left) == 1 and left[0] in hitl_jax.__all__
    else:
        path /= "__init__.py"
    if len(left) > 2:
        return False
    body = ast.parse(_source(path)).body
    for name in left:
        found = [node for node in body if name in _defines(node)]
        if not found:
            return False
        body = getattr(found[0], "body", [])
    return True


@functools.cache
def _source(path):
    return path.read_text()


def _defines(node):
    """The names that a statement binds."""
    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
        return {node.name}
    if isinstance(node, ast.ImportFrom):
        return {alias.asname or alias.name for alias in node.names}
    if isinstance(node, ast.Assign):
        return {
            each.id
            for target in node.targets
            for each in ast.walk(target)
            if isinstance(each, ast.Name)
        }
    if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
        return {node.target.id}
    return set()
