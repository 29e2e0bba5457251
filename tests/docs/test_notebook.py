"""The notebook runs, with a comparison that is as small as tests need it."""

import json

import pytest
import small
from pages import ROOT

nbformat = pytest.importorskip("nbformat", reason='pip install -e ".[docs]"')
nbclient = pytest.importorskip("nbclient", reason='pip install -e ".[docs]"')

_NOTEBOOK = ROOT / "docs" / "first_steps.ipynb"
_SWEEP = [
    *("--methods", "hitl-ac", "--seeds", "1", "--episodes", "2", "--test-episodes", "1"),
    *("--warmup-steps", "100", "--workers", "2"),
    *small.OPTIONS,
]


def _is_of_parameters(cell):
    return "parameters" in cell.metadata.get("tags", [])


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.filterwarnings("ignore::ResourceWarning")
def test_it_runs(tmp_path, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    notebook = nbformat.read(_NOTEBOOK, as_version=4)
    [parameters] = filter(_is_of_parameters, notebook.cells)
    assert parameters.source.count("\n") == 2
    parameters.source = f"SWEEP = {_SWEEP!r}\nOUT = {str(tmp_path / 'swept')!r}"
    client = nbclient.NotebookClient(
        notebook, timeout=300, resources={"metadata": {"path": str(tmp_path)}}
    )
    client.execute()
    pictures = [
        output
        for cell in notebook.cells
        for output in cell.get("outputs", [])
        if "image/png" in output.get("data", {})
    ]
    assert len(pictures) == 3


def test_it_is_kept_with_what_it_shows_and_names_no_machine():
    cells = json.loads(_NOTEBOOK.read_text())["cells"]
    made = [cell for cell in cells if cell["cell_type"] == "code"]
    counts = [cell["execution_count"] for cell in made]
    assert counts == list(range(1, len(made) + 1))
    outputs = [output for cell in made for output in cell["outputs"]]
    assert not [output for output in outputs if output["output_type"] == "error"]
    assert not [output for output in outputs if output.get("name") == "stderr"]
    assert "/home/" not in str(outputs) and "/tmp/" not in str(outputs)
