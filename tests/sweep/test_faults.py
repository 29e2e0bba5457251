"""The command that kills sweeps: how it compares, and its bad input."""

import shutil

import numpy as np
import pytest
from example_results import CONFIG, KEY, save

from hitl_jax.commands.faults import main
from hitl_jax.console.cli import run_main
from hitl_jax.faults.killed_sweeps import differences
from hitl_jax.results.folder import ResultsFolder
from hitl_jax.results.run_key import RunKey


@pytest.fixture
def folders(tmp_path):
    one = ResultsFolder(tmp_path / "one")
    one.create_or_resume(CONFIG, "command")
    save(one)
    shutil.copytree(one.path, tmp_path / "other")
    return one, ResultsFolder(tmp_path / "other")


def test_what_differs_is_named(folders):
    one, other = folders
    assert differences(one, other) == []
    run = other.path / f"runs/{KEY.method}/seed-{KEY.seed:04d}"
    params = one.load_params(KEY)
    params["actor/layer_0/bias"][1] = -0.0  # equal, but not the same
    np.savez(run / "params.npz", **params)
    assert differences(one, other) == [run / "params.npz"]
    (run / "test.csv").write_text((run / "test.csv").read_text() + "\n")
    assert differences(one, other) == [run / "test.csv", run / "params.npz"]
    save(one, RunKey("srl", 0))
    assert differences(one, other) == [other.path / "runs"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--kills", "-1"], "--kills -1: must be at least 0 and at most 2147483647"),
        (["--moves", "-1"], "--moves -1: must be at least 0 and at most 2147483647"),
        (["--longest", "0"], "--longest 0.0: must be at least 0.1"),
        (["--out", "."], "--out .: is there already; name a new folder"),
    ],
)
def test_bad_input_is_one_line(options, message, capsys):
    assert run_main("faults", main, options) == 2
    assert capsys.readouterr().err == f"error: {message}\n"
