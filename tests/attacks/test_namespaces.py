"""Containers that share a disk: process ids mean nothing, locks and temporary names must hold."""

import os
import shutil
import subprocess
import sys
import time

import pytest

from hitl_jax.errors import ResultsError
from hitl_jax.results.atomic_files import locked

_ISOLATED = ["unshare", "--user", "--map-root-user", "--pid", "--fork", "--mount-proc"]

_WRITER = """
import os, pathlib, sys
from hitl_jax.results.atomic_files import write_bytes_atomic
path, letter, end = pathlib.Path(sys.argv[1]), sys.argv[2].encode(), pathlib.Path(sys.argv[3])
print(os.getpid(), flush=True)
while not end.exists():
    write_bytes_atomic(path, letter * 300_000)
"""

_HOLDER = """
import os, pathlib, sys
from hitl_jax.results.atomic_files import locked
with locked(pathlib.Path(sys.argv[1])):
    print(os.getpid(), flush=True)
    sys.stdin.read()
"""


def _isolated(program, *arguments):
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    return subprocess.Popen(
        [*_ISOLATED, sys.executable, "-c", program, *map(str, arguments)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env=environment,
    )


@pytest.fixture(autouse=True)
def _namespaces():
    if shutil.which("unshare") is None:
        pytest.skip("needs unshare, of util-linux")
    if subprocess.run([*_ISOLATED, "true"], capture_output=True, check=False).returncode:
        pytest.skip("the system allows no PID namespaces")


def test_processes_of_equal_ids_write_one_file(tmp_path):
    path, end = tmp_path / "summary.md", tmp_path / "end"
    writers = [_isolated(_WRITER, path, letter, end) for letter in "ab"]
    ids = [writer.stdout.readline() for writer in writers]
    assert ids[0] == ids[1]
    seen = set()
    stop = time.monotonic() + 2.0
    while time.monotonic() < stop:
        if path.exists():
            data = path.read_bytes()
            assert data in (b"a" * 300_000, b"b" * 300_000)
            seen.add(data[:1])
    end.touch()
    for writer in writers:
        writer.communicate()
        assert writer.returncode == 0
    assert seen == {b"a", b"b"}
    assert sorted(one.name for one in tmp_path.iterdir()) == ["end", "summary.md"]


def test_a_lock_holds_between_namespaces(tmp_path):
    holder = _isolated(_HOLDER, tmp_path / "out")
    assert holder.stdout.readline()
    with pytest.raises(ResultsError, match="is in use by process"), locked(tmp_path / "out"):
        pass
    holder.communicate()
    assert holder.returncode == 0
    with locked(tmp_path / "out"):
        pass
