"""Small sweeps that are made in one go, or killed at random moments and started again."""

import contextlib
import os
import pathlib
import random
import signal
import subprocess
from collections.abc import Callable, Iterator

import numpy as np

from hitl_jax.envs.interpreter import child_interpreter
from hitl_jax.errors import LaunchError
from hitl_jax.faults.disturbances import Site, disturb, make_another
from hitl_jax.results.folder import ResultsFolder
from hitl_jax.results.run_files import RUN_FILES

_SWEEP = (
    *("--seeds", "1", "--episodes", "150", "--test-episodes", "4", "--learner", "td3"),
    *("--hidden-sizes", "16", "--batch-size", "16", "--capacity", "5000", "--warmup-steps", "500"),
    *("--save-seconds", "1"),
)


Say = Callable[[str], None]


def make_whole(out: pathlib.Path) -> None:
    """Makes the sweep in one go.

    Raises:
        LaunchError: if it fails.
    """
    with _sweep(out) as sweep:
        _wait(sweep)


def disturb_sweep(
    out: pathlib.Path, moments: random.Random, longest: float, moves: int, say: Say
) -> list[str]:
    """Makes the sweep while its folder is moved, linked, or used twice.

    Args:
        out: the folder with the `whole` one; this one is `disturbed`.
        moments: when.
        longest: time from a start to a disturbance [s].
        moves: how many.
        say: is told of each.

    Returns:
        The lines of those that were not as it should be.

    Raises:
        LaunchError: if a sweep fails.
    """
    make_another(out / "whole", out / "another")
    site = Site(
        out / "disturbed",
        out / "another",
        out / "aside",
        lambda *more: _sweep(out / "disturbed", *more),
    )
    wrong = []
    for line in disturb(site, moments, longest, moves):
        say(line)
        if not line.endswith("as it should be"):
            wrong.append(line)
    return wrong


def kill_sweeps(
    out: pathlib.Path, moments: random.Random, longest: float, kills: int, say: Say
) -> None:
    """Makes the sweep, and kills it again and again.

    Args:
        out: its folder.
        moments: when.
        longest: time from a start, or from the first save after it, to a kill [s].
        kills: how many.
        say: is told of each.

    Raises:
        LaunchError: if a sweep fails.
    """
    for kill in range(1, kills + 1):
        with _sweep(out) as sweep:
            if _ends_before(sweep, out, moments, longest):
                say(f"the sweep ended before kill {kill}")
                _wait(sweep)
                return
            sweep.kill()
            sweep.wait()
        say(f"kill {kill} of {kills}: the sweep; {_state(out)}")
    with _sweep(out) as sweep:
        _wait(sweep)


def kill_workers(
    out: pathlib.Path, moments: random.Random, longest: float, kills: int, say: Say
) -> None:
    """Makes the sweep, and kills its walker processes one by one; see `kill_sweeps`."""
    done = 0
    with _sweep(out) as sweep:
        while done < kills:
            if _ends_before(sweep, out, moments, longest):
                say(f"the sweep ended before kill {done + 1}")
                break
            workers = _workers_of(sweep.pid)
            if workers:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(moments.choice(workers), signal.SIGKILL)
                    done += 1
                    say(f"kill {done} of {kills}: a walker process")
        _wait(sweep)


def _ends_before(
    sweep: subprocess.Popen[bytes], out: pathlib.Path, moments: random.Random, longest: float
) -> bool:
    """Waits for the moment of the next kill; whether the sweep ended first."""
    before = _newest_save(out)
    # One kill in four can meet a start, the others what comes after it.
    at_work = moments.random() < 0.75
    while at_work and _newest_save(out) == before and not _sleep(sweep, 0.1):
        pass
    return _sleep(sweep, moments.uniform(0.0, longest))


@contextlib.contextmanager
def _sweep(out: pathlib.Path, *options: str) -> Iterator[subprocess.Popen[bytes]]:
    """A sweep under way; its words go to a file."""
    python, environment = child_interpreter()
    command = [*python, "-m", "hitl_jax", "sweep", *_SWEEP, *options, "--out", str(out)]
    with open(out.with_suffix(".log"), "ab") as log:
        sweep = subprocess.Popen(command, stdout=log, stderr=log, env=environment)
        try:
            yield sweep
        finally:
            sweep.kill()
            sweep.wait()


def _wait(sweep: subprocess.Popen[bytes]) -> None:
    if sweep.wait():
        raise LaunchError(f"a sweep ended with exit code {sweep.returncode}; its log says why")


def _sleep(sweep: subprocess.Popen[bytes], seconds: float) -> bool:
    """Whether the sweep ended meanwhile."""
    with contextlib.suppress(subprocess.TimeoutExpired):
        sweep.wait(seconds)
    return sweep.returncode is not None


def _workers_of(parent: int) -> list[int]:
    """Walker processes that a sweep has started."""
    found = subprocess.run(
        ["pgrep", "-P", str(parent), "-f", "hitl_jax.envs.worker"], stdout=subprocess.PIPE
    )
    return [int(word) for word in found.stdout.split()]


def _state(out: pathlib.Path) -> str:
    return f"save {_newest_save(out)}, {len(list(out.glob('runs/*/*')))} runs finished"


def _newest_save(out: pathlib.Path) -> int:
    """Its number; 0 if there is none."""
    return max((int(path.stem[-6:]) for path in out.glob("under_way/state-*.npz")), default=0)


def differences(one: ResultsFolder, other: ResultsFolder) -> list[pathlib.Path]:
    """Files of runs that hold other numbers."""
    if one.finished() != other.finished():
        return [other.path / "runs"]
    different = []
    for path in sorted(one.path.glob("runs/*/*")):
        for name in RUN_FILES:
            there = other.path / path.relative_to(one.path) / name
            if not _same(path / name, there):
                different.append(there)
    return different


def _same(one: pathlib.Path, other: pathlib.Path) -> bool:
    if one.suffix != ".npz":
        return one.read_bytes() == other.read_bytes()
    with np.load(one) as here, np.load(other) as there:
        return here.files == there.files and all(
            here[name].tobytes() == there[name].tobytes() for name in here.files
        )
