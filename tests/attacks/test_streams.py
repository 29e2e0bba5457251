"""Output that nobody reads any more."""

import os
import subprocess
import sys

import pytest

_PROGRAM = """
import sys
from hitl_jax.console.output import go_on_without_readers
go_on_without_readers()
go_on_without_readers()
for number in range(20_000):
    print(f"line {number}", flush=number % 7 == 0)
print("the end", file=sys.stderr)
sys.exit(3)
"""


@pytest.fixture(params=["", "1"])
def unbuffered(request):
    return request.param


def _run(redirection: str, unbuffered: str = "") -> subprocess.CompletedProcess:
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    environment |= {"PROGRAM": _PROGRAM, "PYTHON": sys.executable}
    environment |= {"PYTHONUNBUFFERED": unbuffered}
    command = f'("$PYTHON" -c "$PROGRAM"; echo "code $?" >&3) 3>&2 {redirection}'
    return subprocess.run(
        ["bash", "-c", command], env=environment, capture_output=True, text=True, timeout=60
    )


def test_work_goes_on_when_nobody_reads(unbuffered):
    done = _run("| head -1", unbuffered)
    assert done.stdout == "line 0\n"
    told, end, code = done.stderr.splitlines()
    assert told == "nobody reads standard output any more: going on without it"
    assert (end, code) == ("the end", "code 3")


def test_nor_the_errors(unbuffered):
    done = _run("2>&1 | head -1", unbuffered)
    assert done.stdout == "line 0\n"
    assert done.stderr == "code 3\n"


@pytest.mark.parametrize("redirection", [">&-", "> /dev/null"])
def test_no_output_at_all(redirection):
    assert _run(redirection).stderr.splitlines()[-2:] == ["the end", "code 3"]


def test_a_full_disk_is_still_an_error():
    done = _run("> /dev/full")
    assert "No space left on device" in done.stderr
    assert "the end" not in done.stderr
