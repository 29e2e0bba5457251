"""Results folders: what is written is read back, writes are atomic, refusals say why."""

import json
import os
import subprocess
import sys

import numpy as np
import pandas as pd
import pytest
from example_results import CONFIG, KEY, make_episodes, make_info, make_params, make_tests, save
from forged import as_of_format_1

from hitl_jax.errors import ResultsError
from hitl_jax.results import atomic_files, provenance
from hitl_jax.results import folder as results
from hitl_jax.results.atomic_files import write_text_atomic
from hitl_jax.results.config_diff import ConfigMismatch, completed
from hitl_jax.results.episode_tables import EPISODE_COLUMNS, TEST_COLUMNS
from hitl_jax.results.folder import ResultsFolder
from hitl_jax.results.run_key import RunKey


def everything_below(path) -> set[str]:
    return {str(p.relative_to(path)) for p in path.rglob("*")}


def test_a_saved_run_is_read_back(folder):
    save(folder)
    assert folder.finished() == {KEY}
    [run] = folder.load_all()
    assert run.key == KEY
    assert run.info["status"] == "finished"
    assert run.info["wall_seconds"] == 1.5
    assert tuple(run.episodes) == EPISODE_COLUMNS
    assert tuple(run.tests) == TEST_COLUMNS
    for name, values in make_episodes().items():
        np.testing.assert_array_equal(run.episodes[name], values, err_msg=name)
    assert run.episodes["episode"].dtype == np.int64
    assert run.tests["mode"].tolist() == ["autonomous", "assisted"]
    params = folder.load_params(KEY)
    assert params.keys() == make_params().keys()
    np.testing.assert_array_equal(params["actor/layer_0/kernel"], np.arange(6).reshape(2, 3))
    assert params["actor/layer_0/kernel"].dtype == np.float32


def test_pandas_and_numpy_read_the_files(folder):
    save(folder)
    path = folder.path / "runs/hitl-ac/seed-0003"
    tables = {"episodes.csv", "test.csv", "progress.csv", "diagnostics.csv"}
    assert everything_below(path) == tables | {
        *("run.json", "params.npz", "episodes.npz", "README.md")
    }
    frame = pd.read_csv(path / "episodes.csv")
    assert tuple(frame.columns) == EPISODE_COLUMNS
    assert frame["final_boundary"].isna().all()
    assert frame["lead_steps"].isna().tolist() == [False, True, True, True]
    assert frame["env_steps"].tolist() == [100, 200, 300, 400]
    np.testing.assert_allclose(frame["return"], make_episodes()["return"], rtol=1e-14)
    assert pd.read_csv(path / "test.csv")["mode"].tolist() == ["autonomous", "assisted"]
    with np.load(path / "params.npz", allow_pickle=False) as archive:
        assert set(archive.files) == set(make_params())
    assert json.loads((path / "run.json").read_text())["seed"] == 3
    config = json.loads((folder.path / "config.json").read_text())
    assert config["command"] == "hitl-jax sweep"
    assert config["versions"]["numpy"] == np.__version__


def test_a_run_without_tests_is_read_back(folder):
    none = {name: [] for name in TEST_COLUMNS}
    folder.save_run(KEY, make_episodes(), none, make_params(), make_info())
    assert len(folder.load_run(KEY).tests["return"]) == 0


def test_tests_during_training_are_kept_and_may_be_missing(folder):
    tests = make_tests()
    progress = tests | {"trained": [2, 4]}
    folder.save_run(KEY, make_episodes(), tests, make_params(), make_info(), progress)
    kept = folder.load_run(KEY).progress
    assert kept["trained"].tolist() == [2, 4]
    assert kept["mode"].tolist() == list(tests["mode"])
    # Older programs tested autonomously alone, and did not say so; still older ones did not test.
    as_of_format_1(folder.path / "runs/hitl-ac/seed-0003")
    file = folder.path / "runs/hitl-ac/seed-0003/progress.csv"
    rows = [line.split(",") for line in file.read_text().splitlines()]
    file.write_text("".join(",".join([row[0], *row[2:]]) + "\n" for row in rows))
    assert rows[0][1] == "mode"
    assert folder.load_run(KEY).progress["mode"].tolist() == ["autonomous"] * 2
    file.unlink()
    assert len(folder.load_run(KEY).progress["trained"]) == 0


def test_a_test_during_training_after_more_episodes_than_there_are_is_damage(folder):
    tests = make_tests()
    progress = tests | {"trained": [2, 5]}
    folder.save_run(KEY, make_episodes(), tests, make_params(), make_info(), progress)
    with pytest.raises(ResultsError, match="has 4 training episodes, and was tested during"):
        folder.load_run(KEY)


def test_runs_are_listed_by_method_then_seed(folder):
    for key in (RunKey("hitl-ac", 0), RunKey("srl", 10), RunKey("srl", 2), RunKey("hitl-fix", 1)):
        save(folder, key)
    names = [str(run.key) for run in folder.load_all()]
    assert names == ["srl seed 2", "srl seed 10", "hitl-fix seed 1", "hitl-ac seed 0"]


def test_a_finished_run_is_not_overwritten(folder):
    save(folder)
    with pytest.raises(ResultsError, match="seed-0003: this run is finished already"):
        save(folder)


@pytest.mark.parametrize("failing", ["test.csv", "run.json", "rename"])
def test_a_failure_while_saving_leaves_nothing(folder, monkeypatch, failing):
    before = everything_below(folder.path)
    real = atomic_files.write_synced

    def write(descriptor, data):
        if failing in os.readlink(f"/proc/self/fd/{descriptor}"):
            os.write(descriptor, data[:10])
            raise OSError(28, "No space left on device")
        real(descriptor, data)

    def rename(source, target):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(atomic_files, "write_synced", write)
        if failing == "rename":
            patch.setattr(os, "rename", rename)
        with pytest.raises(ResultsError, match="seed-0003: No space left on device"):
            save(folder)
    assert everything_below(folder.path) - before <= {"runs", "runs/hitl-ac"}
    assert folder.finished() == set()
    folder.create_or_resume(CONFIG, "again")
    save(folder)
    assert folder.finished() == {KEY}


def test_a_resume_removes_a_killed_process_files(folder):
    save(folder, RunKey("srl", 0))
    whole = everything_below(folder.path)
    # As after a kill -9 in the middle of `save_run` and of `write_partial`.
    half = folder.path / "runs/srl/.tmp-0123456789abcdef"
    half.mkdir()
    (half / "episodes.csv").write_text("episode,ret")
    (folder.path / "partial").mkdir()
    (folder.path / "partial/.tmp-fedcba9876543210").write_text("epi")
    assert folder.finished() == {RunKey("srl", 0)}
    assert folder.load_partials() == {}
    folder.create_or_resume(CONFIG, "again")
    assert everything_below(folder.path) == whole | {"partial"}


def test_an_atomic_write_keeps_the_old_text(tmp_path, monkeypatch):
    path = tmp_path / "new" / "summary.md"
    write_text_atomic(path, "old")

    def fail(source, target):
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(KeyboardInterrupt):
        write_text_atomic(path, "new")
    assert path.read_text() == "old"
    assert everything_below(path.parent) == {"summary.md"}


def test_partial_episodes_are_replaced_and_give_way_to_the_run(folder):
    folder.write_partial(KEY, make_episodes(2))
    folder.write_partial(KEY, make_episodes(3))
    [(key, episodes)] = folder.load_partials().items()
    assert (key, len(episodes["return"])) == (KEY, 3)
    save(folder)
    assert folder.load_partials() == {}  # even before the file is removed
    folder.remove_partial(KEY)
    folder.remove_partial(KEY)
    assert everything_below(folder.path / "partial") == set()


def test_the_same_config_resumes(folder):
    folder.create_or_resume(CONFIG, "another command")
    written = json.loads((folder.path / "config.json").read_text())["config"]
    assert written == {
        "agent": {"learner": "td3", "matmul_precision": "float32", "hidden_sizes": [128, 128]},
        "hyper": {"gamma": 0.98},
    }
    assert folder.load_config() == completed(written)  # With the defaults of later choices.
    assert "hitl-jax sweep" in (folder.path / "config.json").read_text()


def test_an_older_folder_without_an_entry_resumes_with_its_default(tmp_path):
    folder = ResultsFolder(tmp_path)
    folder.create_or_resume({"agent": {"learner": "td3"}}, "command")
    config = {"agent": {"learner": "td3", "matmul_precision": "float32"}}
    folder.create_or_resume(config, "command")
    config["agent"]["matmul_precision"] = "bfloat16"
    with pytest.raises(
        ConfigMismatch, match='precision: folder has "float32", asked for "bfloat16"'
    ):
        folder.create_or_resume(config, "command")


def test_other_code_is_reported(folder, monkeypatch):
    assert folder.create_or_resume(CONFIG, "again") == []
    now = {"python": "9.9", "numpy": results.versions()["numpy"]}
    monkeypatch.setattr(results, "versions", lambda: now)
    monkeypatch.setattr(results, "git_commit", lambda: "abc")
    told = folder.create_or_resume(CONFIG, "again")
    assert told[0].startswith("commit ") and told[0].endswith(", now abc")
    assert any(line.startswith("python 3.") and line.endswith(", now 9.9") for line in told)
    assert not any(line.startswith("numpy") for line in told)


def test_another_config_is_refused_with_its_differences(folder):
    other = {"agent": CONFIG["agent"] | {"learner": "ddpg"}, "hyper": {"tau": 1}}
    with pytest.raises(ConfigMismatch) as caught:
        folder.create_or_resume(other, "command")
    assert str(caught.value) == (
        f'{folder.path}: made with another config: agent.learner: folder has "td3", asked for '
        '"ddpg"; hyper.gamma: folder has 0.98, asked for nothing; hyper.tau: folder has nothing, '
        "asked for 1"
    )


def test_many_differences_are_cut_at_five(tmp_path):
    folder = ResultsFolder(tmp_path)
    folder.create_or_resume({f"k{i}": 0 for i in range(8)}, "command")
    with pytest.raises(ConfigMismatch) as caught:
        folder.create_or_resume({f"k{i}": 1 for i in range(8)}, "command")
    message = str(caught.value)
    assert message.count("folder has") == 5
    assert message.endswith("; and 3 more")
    assert "\n" not in message


def test_provenance(tmp_path, monkeypatch):
    found = provenance.versions()
    assert found["numpy"] == np.__version__
    assert {"python", "jax", "gymnasium"} <= set(found)
    # A stand-in repository: the commit of this one changes from day to day.
    code = tmp_path / "code.py"
    code.write_text("")
    monkeypatch.setattr(provenance, "__file__", str(code))
    assert provenance.git_commit() is None

    def git(*arguments):
        identity = ["-c", "user.name=n", "-c", "user.email=e@example.org"]
        subprocess.run(["git", *identity, *arguments], cwd=tmp_path, check=True)

    git("init", "-q")
    assert provenance.git_commit() is None  # not tracked: a package below somebody's checkout
    git("add", "code.py")
    git("commit", "-q", "--no-verify", "-m", "m")
    clean = provenance.git_commit()
    assert clean is not None
    assert len(clean) == 40
    code.write_text("changed")
    assert provenance.git_commit() == clean + "-dirty"


def test_reading_results_needs_no_jax():
    code = (
        "import sys\n"
        "from hitl_jax.results import atomic_files, episode_tables, folder, provenance\n"
        "from hitl_jax.analysis import figures, stats, summary\n"
    )
    code += "assert not {'jax', 'pandas', 'gymnasium', 'matplotlib.pyplot'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_a_processor_of_any_name_can_be_kept(folder, monkeypatch):
    """Firmware gives names with tabs, a NUL at the end, or non-breaking spaces."""
    monkeypatch.setattr(provenance.platform, "processor", lambda: "A\tcore\xa05\0")
    monkeypatch.setattr("builtins.open", _no_cpuinfo(open))
    machine = f"{provenance.processor()}, 2 cores"
    assert machine == "A core 5, 2 cores"
    info = make_info(machine=machine)
    folder.save_run(KEY, make_episodes(), make_tests(), make_params(), info)
    assert folder.load_run(KEY).info["machine"] == machine


def _no_cpuinfo(real):
    def opened(path, *arguments, **more):
        if path == "/proc/cpuinfo":
            raise FileNotFoundError(path)
        return real(path, *arguments, **more)

    return opened
