"""Folders of made-up runs."""

import pytest
from example_figures import CONFIG
from example_training import make_training

from hitl_jax.analysis.figures import draw_all
from hitl_jax.results.folder import ResultsFolder
from hitl_jax.results.run_key import RunKey


@pytest.fixture
def folder(tmp_path):
    folder = ResultsFolder(tmp_path / "out")
    folder.create_or_resume(CONFIG, "command")
    return folder


@pytest.fixture
def plain(folder):
    """A folder with the two figures that it has data for, drawn without any settings."""
    folder.write_partial(RunKey("srl", 0), make_training("srl", 0))
    drawn = draw_all(folder)
    assert len(drawn.paths) == 4 and drawn.failures == []
    return folder
