"""A sweep that is killed again and again: `hitl-jax faults`.

Makes a small sweep in one go, then twice more: once the whole of it is killed (SIGKILL) at random
moments and started again each time, once its walker processes are. A fourth one is disturbed as
people do it: its folder is moved, linked, or used twice. Compares every table and every parameter
with those of the first.
"""

import contextlib
import dataclasses
import os
import pathlib
import random
import signal
import subprocess
from collections.abc import Iterator

import numpy as np

from hitl_jax.choices.checks import require, require_whole
from hitl_jax.console.cli import checking_input
from hitl_jax.envs import require_backend
from hitl_jax.envs.interpreter import child_interpreter
from hitl_jax.errors import BadInput
from hitl_jax.faults.disturbances import Site, disturb, make_another
from hitl_jax.results.folder import ResultsFolder

_SWEEP = (
    *("--seeds", "1", "--episodes", "150", "--test-episodes", "4", "--learner", "td3"),
    *("--hidden-sizes", "16", "--batch-size", "16", "--capacity", "5000", "--warmup-steps", "500"),
    *("--save-seconds", "1"),
)
_TABLES = ("episodes.csv", "test.csv", "progress.csv", "params.npz", "episodes.npz")


@dataclasses.dataclass(frozen=True)
class FaultOptions:
    """Kill and disturb small sweeps at random moments; they must end as if nothing had happened.

    Attributes:
        kills: of the whole sweep, and again of single walker processes.
        moves: of its folder, links put in its place, second starts, foreign runs.
        first: what the random moments start from.
        longest: longest time from a start, or from the first save after it, to a kill [s]; half of
            it for walker processes.
        out: a new folder for the three sweeps.
    """

    kills: int = 20
    moves: int = 20
    first: int = 0
    longest: float = 6.0
    out: str = "runs/faults"


def main(options: FaultOptions) -> int:
    """Runs the sweeps, and compares.

    Args:
        options: how often to kill.

    Returns:
        The exit code: 0 if all is equal, else 1.

    Raises:
        BadInput: if the folder is there already.
    """
    with checking_input():
        for name in ("kills", "moves"):
            require_whole(name, getattr(options, name))
        require("longest", options.longest, at_least=0.1)
        require_backend("lean")  # Its walkers have processes that can be killed.
    out = pathlib.Path(options.out)
    if out.exists():
        raise BadInput(f"--out {out}: is there already; name a new folder")
    out.mkdir(parents=True)
    moments = random.Random(options.first)
    with _sweep(out / "whole") as sweep:
        _wait(sweep)
    print("made in one go", flush=True)
    if options.kills:
        _kill_sweeps(out / "killed", moments, options)
        _kill_workers(out / "workers", moments, options)
    wrong = _disturb(out, moments, options) if options.moves else []
    differ = [
        path
        for name in ("killed", "workers", "disturbed")
        if (out / name).exists()
        for path in _differences(ResultsFolder(out / "whole"), ResultsFolder(out / name))
    ]
    for path in differ:
        print(f"differs: {path}")
    print("differences were found" if differ else "all tables and parameters are equal")
    return 1 if differ or wrong else 0


def _disturb(out: pathlib.Path, moments: random.Random, options: FaultOptions) -> list[str]:
    """What was not as it should be."""
    make_another(out / "whole", out / "another")
    site = Site(
        out / "disturbed",
        out / "another",
        out / "aside",
        lambda *more: _sweep(out / "disturbed", *more),
    )
    wrong = []
    for line in disturb(site, moments, options.longest, options.moves):
        print(line, flush=True)
        if not line.endswith("as it should be"):
            wrong.append(line)
    return wrong


def _kill_sweeps(out: pathlib.Path, moments: random.Random, options: FaultOptions) -> None:
    for kill in range(1, options.kills + 1):
        with _sweep(out) as sweep:
            if _ends_before(sweep, out, moments, options.longest):
                print(f"the sweep ended before kill {kill}", flush=True)
                _wait(sweep)
                return
            sweep.kill()
            sweep.wait()
        print(f"kill {kill} of {options.kills}: the sweep; {_state(out)}", flush=True)
    with _sweep(out) as sweep:
        _wait(sweep)


def _kill_workers(out: pathlib.Path, moments: random.Random, options: FaultOptions) -> None:
    kills = 0
    with _sweep(out) as sweep:
        while kills < options.kills:
            if _ends_before(sweep, out, moments, options.longest / 2):
                print(f"the sweep ended before kill {kills + 1}", flush=True)
                break
            workers = _workers_of(sweep.pid)
            if workers:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(moments.choice(workers), signal.SIGKILL)
                    kills += 1
                    print(f"kill {kills} of {options.kills}: a walker process", flush=True)
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
        raise BadInput(f"a sweep ended with exit code {sweep.returncode}; its log says why")


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


def _differences(one: ResultsFolder, other: ResultsFolder) -> list[pathlib.Path]:
    """Files of runs that hold other numbers."""
    if one.finished() != other.finished():
        return [other.path / "runs"]
    different = []
    for path in sorted(one.path.glob("runs/*/*")):
        for name in _TABLES:
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
