"""Code that somebody else's file names is run where its reader trusts it, and nowhere else."""

import re

import pytest

from hitl_jax.choices.registry import TRUSTED, require_trusted
from hitl_jax.errors import ResultsError

_NAMED = {
    "learner": "my_sac:sac",
    "indicator": "hull_angle",
    "human_parts": ("delay", "my_team:startled"),
    "backend": "my_team:poles",
    "batch_size": 64,
}


@pytest.mark.parametrize(
    ("trusts", "told"),
    [
        (
            "",
            "theirs.json: names code that would be run: learner my_sac:sac, human_parts "
            "my_team:startled, backend my_team:poles; if you trust it, add my_sac and my_team to "
            f"{TRUSTED}: {TRUSTED}=my_sac,my_team",
        ),
        (
            "evil, my_team",
            "theirs.json: names code that would be run: learner my_sac:sac; if you trust it, add "
            f"my_sac to {TRUSTED}: {TRUSTED}=evil,my_team,my_sac",
        ),
    ],
)
def test_all_that_is_not_trusted_is_told_at_once(trusts, told, monkeypatch):
    monkeypatch.setenv(TRUSTED, trusts)
    with pytest.raises(ResultsError, match=f"^{re.escape(told)}$"):
        require_trusted("theirs.json", _NAMED)


@pytest.mark.parametrize("trusts", ["my_sac,my_team", " my_team , my_sac, ", "a,my_team, my_sac"])
def test_names_may_have_spaces_between_them(trusts, monkeypatch):
    monkeypatch.setenv(TRUSTED, trusts)
    require_trusted("theirs.json", _NAMED)
