"""A sweep on several machines: shards, and a Ray cluster whose machines are processes here."""

import contextlib
import os
import pathlib
import re
import shutil
import signal
import subprocess
import sys
import threading

import pytest
import small
from forged import rewrite

from hitl_jax.commands import merge
from hitl_jax.commands.seed_sweep import main
from hitl_jax.console.cli import run_main
from hitl_jax.results.folder import ResultsFolder
from hitl_jax.results.run_files import RUN_FILES
from hitl_jax.sweep import run_sweep

# A cluster begins by a fork, in which nothing of JAX's is used.
pytestmark = [
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore:os.fork", "ignore::ResourceWarning"),
]

_OPTIONS = [
    *("--methods", "srl", "--seeds", "4", "--episodes", "2", "--test-episodes", "1"),
    *("--warmup-steps", "64", *small.OPTIONS),
]


def _sweep(out, *options):
    return run_main("sweep", main, [*_OPTIONS, *options, "--out", str(out)])


def _merge(*arguments):
    return run_main("merge", merge.main, [*map(str, arguments)])


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    out = tmp_path_factory.mktemp("whole") / "results"
    assert _sweep(out) == 0
    return out


def _assert_equal(out, whole):
    names = sorted(path.relative_to(whole) for path in whole.glob("runs/*/*/*"))
    assert sorted(path.relative_to(out) for path in out.glob("runs/*/*/*")) == names
    assert len(names) == 4 * (len(RUN_FILES) + 2)
    for name in names:
        if name.name in RUN_FILES:
            assert (out / name).read_bytes() == (whole / name).read_bytes(), name


@pytest.fixture(scope="module")
def shards(tmp_path_factory):
    folder = tmp_path_factory.mktemp("shards")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run_sweep, "draw", lambda _: [])  # What is merged is drawn.
        for number in range(1, 5):
            assert _sweep(folder / str(number), "--shard", f"{number}/4") == 0
    return [folder / str(number) for number in range(1, 5)]


def test_shards_merged_are_the_whole(shards, whole, tmp_path, capsys):
    out = tmp_path / "merged"
    for _ in range(2):  # The second time there is nothing left to copy.
        assert _merge(*reversed(shards), "--out", out) == 0
        assert f"4 runs of 4 shards: {out}" in capsys.readouterr().out
    _assert_equal(out, whole)
    assert ResultsFolder(out).load_config() == ResultsFolder(whole).load_config()
    assert ResultsFolder(out).load_shard() is None
    assert (out / "figures" / "figure4_training.png").exists()


def test_what_is_no_set_of_shards_is_named(shards, whole, tmp_path, capsys):
    one, two, three, four = shards
    foreign, lacking, other = (tmp_path / name for name in ("foreign", "lacking", "other"))
    for folder, source in ((foreign, four), (lacking, two), (other, four)):
        shutil.copytree(source, folder)
    rewrite(
        foreign / "config.json", lambda made: made["config"]["hyper"].update({"warmup_steps": 5})
    )
    rewrite(other / "config.json", lambda made: made["shard"].update({"of": 5}))
    shutil.rmtree(lacking / "runs")
    out = tmp_path / "out"
    for folders, said in (
        ([], "FOLDER (none): must be the folders of all shards"),
        ([one, three], "shards 2/4, 4/4: missing"),
        ([one, two, three, four, two], f"{two}: shard 2/4 is there twice: also as {two}"),
        ([one, two, three, foreign], f"{foreign}: made with another config: hyper.warmup_steps"),
        ([one, two, three, other], f"{other}: made with another config: shard.of"),
        (
            [one, lacking, three, four],
            f"{lacking}: shard 2/4 lacks 1 of its 1 runs (srl-seed-",
        ),
        ([one, whole], f"{whole}: is no shard: it was made without --shard"),
        ([one, tmp_path / "none"], f"{tmp_path / 'none'}: no results here"),
    ):
        assert _merge(*folders, "--out", out) == 2
        error = capsys.readouterr().err
        assert said in error
        assert error.count("\n") == 1
    assert not out.exists()


def test_a_folder_is_of_one_shard(shards, capsys):
    for option, said in (
        (["--shard", "2/4"], "shard.number: folder has 1, asked for 2"),
        ([], "folder has 4, asked for nothing"),
        (["--shard", "5/4"], "--shard 5/4: must be NUMBER/OF"),
        (["--shard", "1/9"], "--shard 1/9: has none of the 4 runs"),
    ):
        assert _sweep(shards[0], *option) == 2
        assert said in capsys.readouterr().err


@pytest.fixture(scope="module")
def ray():
    return pytest.importorskip("ray", reason='needs pip install -e ".[ray]"')


@pytest.fixture
def cluster(ray):
    """A head without cores, and two machines of one core each."""
    from ray.cluster_utils import Cluster

    head = {"num_cpus": 0, "include_dashboard": False}
    made = Cluster(initialize_head=True, head_node_args=head)
    try:
        made.machines = [made.add_node(num_cpus=1) for _ in range(2)]
        yield made
    finally:
        made.shutdown()


class _Driver:
    """A sweep on a cluster, in a process of its own, and what it has said."""

    def __init__(self, cluster, out):
        options = ["--launcher", "ray", "--ray-address", cluster.address, "--out", str(out)]
        command = [sys.executable, "-m", "hitl_jax", "sweep", *_OPTIONS, *options]
        env = {name: value for name, value in os.environ.items() if name != "JAX_NUM_CPU_DEVICES"}
        self.process = subprocess.Popen(
            command,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            env=env | {"PYTHONUNBUFFERED": "1"},
        )
        self._patience = threading.Timer(400, self.process.kill)
        self._patience.start()
        self.said = ""

    def until(self, words, times=1):
        """Waits for lines with these words."""
        for _ in range(times):
            self._read(lambda line: words in line)
            assert self.process.poll() is None, self.said

    def end(self, code=0):
        """Waits for the end."""
        self._read(lambda _: False)
        assert self.process.wait() == code, self.said

    def _read(self, enough):
        for line in self.process.stdout:
            self.said += line
            if enough(line):
                return

    def close(self):
        self._patience.cancel()
        self.process.kill()
        self.process.wait()
        self.process.stdout.close()


def test_a_driver_that_is_killed_goes_on(cluster, whole, tmp_path):
    """Nothing that was finished is made again."""
    out = tmp_path / "results"
    with contextlib.closing(_Driver(cluster, out)) as driver:
        driver.until("4 runs in 2 groups on a Ray cluster with room for 2, each of 1 cores\n")
        driver.until("finished ")
        driver.process.send_signal(signal.SIGKILL)
        driver.process.wait()
    before = len(ResultsFolder(out).finished())
    assert 1 <= before < 4
    with contextlib.closing(_Driver(cluster, out)) as driver:
        driver.end()
    assert driver.said.count("\nfinished ") == 4 - before
    _assert_equal(out, whole)
    assert (out / "figures" / "figure4_training.png").exists()


def test_a_machine_that_is_lost_gives_its_runs_back(cluster, whole, tmp_path):
    """One of them dies at once; before that, a process of the other is told to end."""
    out = tmp_path / "results"
    with contextlib.closing(_Driver(cluster, out)) as driver:
        driver.until(" begins 2 runs", times=2)
        os.kill(_makers()[0], signal.SIGTERM)
        driver.until("a machine was lost: ")
        cluster.remove_node(cluster.machines[0], allow_graceful=False)
        driver.end()
    assert driver.said.count("a machine was lost: ") >= 2, driver.said
    finished = re.findall(r"^finished srl seed \d", driver.said, re.MULTILINE)
    assert sorted(finished) == [f"finished srl seed {seed}" for seed in range(4)]
    _assert_equal(out, whole)


def _makers():
    """Processes that make groups of runs: Ray names them by what they do."""
    names = {path: path.read_bytes() for path in pathlib.Path("/proc").glob("[0-9]*/cmdline")}
    return [int(path.parent.name) for path, name in names.items() if b"ray::make_group" in name]


def test_ctrl_c_leaves_the_cluster(cluster, tmp_path):
    out = tmp_path / "results"
    with contextlib.closing(_Driver(cluster, out)) as driver:
        driver.until(" begins 2 runs", times=2)
        driver.process.send_signal(signal.SIGINT)
        driver.end(130)
    assert "Stopped." in driver.said
    assert "makes the runs that are missing" in driver.said
    assert "Traceback" not in driver.said


def test_what_is_no_cluster_is_refused(ray, tmp_path, capsys):
    out = tmp_path / "results"
    assert _sweep(out, "--ray-address", "127.0.0.1:1") == 2
    assert "--ray-address 127.0.0.1:1: needs --launcher ray" in capsys.readouterr().err
    assert _sweep(out, "--launcher", "slurm") == 2
    assert "--launcher slurm: must be one of local, ray" in capsys.readouterr().err
    for address, said in (("127.0.0.1:1", "[Errno 111]"), ("nonsense", "Invalid address format")):
        assert _sweep(out, "--launcher", "ray", "--ray-address", address) == 2
        error = capsys.readouterr().err
        assert error.startswith(f"error: --ray-address {address}: no cluster: {said}")
        assert error.count("\n") == 1
    assert not out.exists()
