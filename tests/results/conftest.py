"""A folder of results."""

import pytest
from example_results import CONFIG

from hitl_jax.results.folder import ResultsFolder


@pytest.fixture
def folder(tmp_path):
    folder = ResultsFolder(tmp_path / "out")
    folder.create_or_resume(CONFIG, "hitl-jax sweep")
    return folder
