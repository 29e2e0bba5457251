"""Folders, runs and files that are damaged are refused in one line."""

import numpy as np
import pytest
from example_results import CONFIG, KEY, make_episodes, make_info, make_params, make_tests, save
from forged import as_of_format_1

from hitl_jax.errors import ResultsError
from hitl_jax.results import folder as results
from hitl_jax.results.episode_tables import TEST_COLUMNS
from hitl_jax.results.folder import ResultsFolder
from hitl_jax.results.recorded_episodes import Recording
from hitl_jax.results.run_files import RUN_FILES
from hitl_jax.results.run_key import RunKey


def test_folders_that_cannot_be_used(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    with pytest.raises(ResultsError, match="file: is a file, not a folder"):
        ResultsFolder(tmp_path / "file").create_or_resume(CONFIG, "command")
    with pytest.raises(ResultsError, match="Not a directory"):
        ResultsFolder(tmp_path / "file/below").create_or_resume(CONFIG, "command")
    with pytest.raises(ResultsError, match=r"holds other files \(file\) and no config.json"):
        ResultsFolder(tmp_path).create_or_resume(CONFIG, "command")
    with pytest.raises(ResultsError, match="no results here"):
        ResultsFolder(tmp_path / "nothing").load_config()

    def refuse(**_):
        raise OSError(30, "Read-only file system")

    # A test may run as root, who can write anywhere.
    monkeypatch.setattr(results.tempfile, "TemporaryFile", refuse)
    with pytest.raises(ResultsError, match="new: Read-only file system"):
        ResultsFolder(tmp_path / "new").create_or_resume(CONFIG, "command")


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("run.json", "{", "damaged: Input data was truncated"),
        ("run.json", '{"format": 3}', "damaged: is not of format 2"),
        ("run.json", '{"format": true}', "damaged: is not of format 2"),
        ("run.json", '{"format": 2}', "damaged: its digest is not"),
        ("run.json", '{"format": 1}', "damaged: Object missing required field `method`"),
        ("episodes.csv", "", "damaged: the header is not episode,return"),
        ("episodes.csv", "episode,return\n", "damaged: the header"),
        ("episodes.csv", b"\xff\xfe", "damaged: .*decode"),
        ("test.csv", ",".join(TEST_COLUMNS) + "\nassisted,1\n", "damaged: line 2 has 2 of 14"),
        ("test.csv", None, "No such file"),
    ],
)
def test_a_damaged_run_names_the_file_in_one_line(folder, name, content, says):
    save(folder)
    path = folder.path / "runs/hitl-ac/seed-0003" / name
    path.unlink()
    if name != "run.json":
        as_of_format_1(folder.path / "runs/hitl-ac/seed-0003")
    if content is not None:
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(ResultsError, match=f"{name}: {says}") as caught:
        folder.load_all()
    assert "\n" not in str(caught.value)


def test_damaged_cells_are_named(folder):
    save(folder)
    as_of_format_1(folder.path / "runs/hitl-ac/seed-0003")
    path = folder.path / "runs/hitl-ac/seed-0003/episodes.csv"
    text = path.read_text()
    for old, new, says in (
        ("goal", "gaol", "column 'end' holds 'gaol'"),
        ("-0.1", "zero", "column 'shaped_return' holds 'zero': must be a number"),
        ("-0.1", "1_0", "column 'shaped_return' holds '1_0': must be a number"),
        ("-0.1", "1.2.3", "column .shaped_return. holds .1.2.3.: must be"),
        ("-0.1", "", "column 'shaped_return' holds a value that is missing"),
        ("\n2,", "\n2.5,", "column 'episode' holds a value that is not a whole number"),
        ("\n2,", "\n-2,", "column 'episode' holds a value that is not from 0 to"),
        ("\n2,", "\n1e300,", "column 'episode' holds a value that is not from 0 to"),
        ("goal", "g" * 200_000, "field larger than field limit"),
        ("12.0\n", "12.0", "line 2 has 31 of 16 cells"),
    ):
        path.write_text(text.replace(old, new, 1))
        with pytest.raises(ResultsError, match=f"episodes.csv: damaged: {says}"):
            folder.load_run(KEY)
    path.write_text(text[:-1])
    with pytest.raises(ResultsError, match="line 5 is cut short"):
        folder.load_run(KEY)


def test_a_run_without_its_run_json_is_named(folder):
    save(folder)
    (folder.path / "runs/hitl-ac/seed-0003/run.json").unlink()
    with pytest.raises(ResultsError, match="seed-0003: is there and holds no finished run"):
        folder.load_all()


@pytest.mark.parametrize("name", RUN_FILES)
def test_a_file_of_another_run_is_refused(folder, name):
    """Also if the other file is whole, as after a careless copy."""
    save(folder)
    columns = make_episodes()
    columns["return"] = columns["return"] + 1.0
    tests = make_tests() | {"return": [1.0, 2.0]}
    progress = tests | {"trained": [2, 4]}
    params = {name: array + 1 for name, array in make_params().items()}
    steps = np.zeros((1, 9), np.float32)
    recordings = {"best": Recording(1, steps)}
    other = RunKey("srl", 0)
    sample = {"updates": 1, "env_steps": 1, "episodes": 1, "q": 0.5}
    folder.save_run(other, columns, tests, params, make_info(), progress, recordings, [sample])
    runs = folder.path / "runs"
    (runs / "hitl-ac/seed-0003" / name).write_bytes((runs / "srl/seed-0000" / name).read_bytes())
    with pytest.raises(ResultsError, match=f"{name}: damaged: is not the file that run.json names"):
        folder.load_run(KEY), folder.load_params(KEY), folder.load_recordings(KEY)


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 cut", b"not an archive"])
def test_damaged_parameters(folder, content):
    save(folder)
    (folder.path / "runs/hitl-ac/seed-0003/params.npz").write_bytes(content)
    with pytest.raises(ResultsError, match=r"params.npz: damaged"):
        folder.load_params(KEY)


def test_bad_columns_info_and_parameters_are_not_saved(folder):
    columns = make_episodes()
    wrong = {n: v for n, v in columns.items() if n != "fall"} | {"falls": columns["fall"]}
    with pytest.raises(ValueError, match=r"columns missing: \['fall'\], unknown: \['falls'\]"):
        folder.save_run(KEY, wrong, make_tests(), make_params(), make_info())
    with pytest.raises(ValueError, match="differ in length"):
        folder.write_partial(KEY, columns | {"fall": [0]})
    info = {n: v for n, v in make_info().items() if n != "updates"}
    with pytest.raises(ValueError, match="info lacks updates"):
        folder.save_run(KEY, columns, make_tests(), make_params(), info)
    with pytest.raises(ValueError, match="'a' is not an array of numbers"):
        folder.save_run(KEY, columns, make_tests(), {"a": np.array([{}])}, make_info())
    with pytest.raises(ValueError, match="not a method"):
        RunKey("../up", 0)
    assert folder.finished() == set()
