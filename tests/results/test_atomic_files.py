"""A lock gives a folder one writer, and ends with its process however that ends."""

import errno
import os
import pathlib
import signal
import subprocess
import sys

import pytest

from hitl_jax.errors import ResultsError
from hitl_jax.results.atomic_files import locked


def test_a_folder_has_one_writer(tmp_path):
    with locked(tmp_path / "new"):
        said = (tmp_path / "new" / ".lock").read_text()
        assert said.startswith(f"process {os.getpid()} on ")
        line = f"{tmp_path / 'new'}: is in use by {said}"
        with pytest.raises(ResultsError) as caught, locked(tmp_path / "new"):
            pass
        assert str(caught.value) == line
    assert not list((tmp_path / "new").iterdir())


def test_a_lock_ends_with_its_process(tmp_path):
    program = (
        "import os, pathlib, signal\nfrom hitl_jax.results.atomic_files import locked\n"
        f"with locked(pathlib.Path({str(tmp_path)!r})):\n"
        "    os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    killed = subprocess.run([sys.executable, "-c", program], env=environment)
    assert killed.returncode == -signal.SIGKILL
    assert (tmp_path / ".lock").exists()
    with locked(tmp_path):
        assert f"process {os.getpid()} " in (tmp_path / ".lock").read_text()


def test_a_path_that_cannot_be_locked(tmp_path):
    (tmp_path / "file").write_text("mine")
    with pytest.raises(ResultsError, match="is a file, not a folder"), locked(tmp_path / "file"):
        pass
    with pytest.raises(ResultsError, match="/proc/nowhere"), locked(pathlib.Path("/proc/nowhere")):
        pass


def test_a_lock_on_a_full_disk(tmp_path, monkeypatch):
    def refuse(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("os.write", refuse)
    with pytest.raises(ResultsError, match="No space left on device"), locked(tmp_path):
        pass
    assert not list(tmp_path.iterdir())
