"""Damage to every file that we read is refused in one line; `damage.py` tries more of it."""

import pytest
from damage import attack, read_all
from formats import FORMATS
from made_files import make

_EACH = 12
"""Damages of each format here; the command has as many as asked for."""


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    root = tmp_path_factory.mktemp("made")
    make(root)
    return root, read_all(root)


@pytest.mark.parametrize("place", range(len(FORMATS)), ids=[form.name for form in FORMATS])
def test_damage_is_refused_or_read_as_it_was(made, place):
    told = [
        (verdict, what)
        for number in range(place, len(FORMATS) * _EACH, len(FORMATS))
        for verdict, what in [attack(*made, 0, number)]
    ]
    assert [one for one in told if one[0] not in ("refused", "as it was", "another")] == []


def test_the_attack_would_see_what_is_wrong(made, monkeypatch):
    """A reader that believes everything, one that breaks, and one that says two lines."""
    root, whole = made
    believing = FORMATS[0]._replace(read=lambda root: (root / FORMATS[0].path).read_bytes())
    breaking = FORMATS[0]._replace(read=lambda root: {}["there is no such name"])

    def say(root):
        raise ValueError("one line\nand another")

    for form, verdict in (
        (believing, "wrong accept"),
        (breaking, "traceback"),
        (FORMATS[0]._replace(read=say), "no line"),
    ):
        monkeypatch.setattr("damage.FORMATS", [form])
        assert attack(root, whole, 1, 0)[0] == verdict
