"""What people do to a folder while a sweep works in it: they move it, link it, start twice.

Whatever was done, another folder and other files must be as they were, a run of another config must
not be read, and a sweep that goes on must end as if nothing had happened.
"""

import contextlib
import pathlib
import random
import shutil
import subprocess
import time
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

from hitl_jax.errors import ResultsError
from hitl_jax.results.atomic_files import LOCK
from hitl_jax.results.folder import ResultsFolder
from hitl_jax.results.json_documents import from_json, to_json

_PATIENCE = 120.0
"""Until a sweep must have noticed what was done to it [s]."""
_OTHER_WARMUP = 450

Start = Callable[..., contextlib.AbstractContextManager[subprocess.Popen[bytes]]]


class Site(NamedTuple):
    """Where it happens.

    Attributes:
        out: the folder that the sweep works in.
        another: a folder of another config, of somebody else.
        aside: where folders are moved to.
        start: starts the sweep, with further options.
    """

    out: pathlib.Path
    another: pathlib.Path
    aside: pathlib.Path
    start: Start


def make_another(whole: pathlib.Path, another: pathlib.Path) -> None:
    """Makes the results of somebody else: those of a sweep, as if of another config.

    Args:
        whole: results of a finished sweep.
        another: a folder, not there yet.
    """
    shutil.copytree(whole, another)
    for path in (another / "config.json", *another.glob("runs/*/*/run.json")):
        _rewrite(
            path, lambda document: document["config"]["hyper"].update(warmup_steps=_OTHER_WARMUP)
        )
    (another / "thesis.tex").write_text("years of work", encoding="utf-8")
    (another / "under_way").mkdir()
    (another / "under_way" / "state-000001.npz").write_bytes(b"somebody's")


def _rewrite(path: pathlib.Path, change: Callable[[dict[str, Any]], None]) -> None:
    document = from_json(path.read_bytes(), dict)
    change(document)
    path.write_text(to_json(document), encoding="utf-8")


def disturb(site: Site, moments: random.Random, longest: float, times: int) -> Iterator[str]:
    """Disturbs a sweep again and again, and lets it end at last.

    Args:
        site: where; the sweep has not begun.
        moments: random numbers.
        longest: time until a disturbance [s].
        times: how often.

    Yields:
        What was done, and what was wrong after it, if anything was.
    """
    before = contents(site.another)
    done = 0
    while done < times:
        with site.start() as sweep:
            while (
                done < times
                and _works(site, sweep)
                and not _ended(sweep, moments.uniform(0.0, longest))
            ):
                name, disturbance = moments.choice(list(_DISTURBANCES.items()))
                done += 1
                wrong = disturbance(site, sweep)
                if contents(site.another) != before:
                    wrong += ["another folder was changed"]
                wrong += _foreign_runs(site.out)
                yield f"{done} of {times}: {name}: {', '.join(wrong) or 'as it should be'}"
        if (site.out / "summary.md").exists() and done < times:
            shutil.rmtree(site.out)  # It had ended: once more from its beginning.
    with site.start() as sweep:
        if sweep.wait():
            yield f"the last start ended with exit code {sweep.returncode}"


def contents(folder: pathlib.Path) -> dict[str, bytes]:
    """Every file below a folder, by name; folders are there, too."""
    every = list(folder.rglob("*"))
    return {str(path): path.read_bytes() if path.is_file() else b"" for path in every}


def _moved(site: Site, sweep: subprocess.Popen[bytes]) -> list[str]:
    """The folder is moved away: it is not made anew."""
    with _away(site):
        wrong = _notices(sweep)
        if site.out.exists():
            shutil.rmtree(site.out)
            wrong.append("the folder was made anew")
    return wrong


def _replaced(site: Site, sweep: subprocess.Popen[bytes]) -> list[str]:
    """Somebody else's results are put in its place."""
    with _away(site):
        shutil.copytree(site.another, site.out)
        before = contents(site.out)
        wrong = _notices(sweep)
        if contents(site.out) != before:
            wrong.append("what was put in its place was changed")
        shutil.rmtree(site.out)
    return wrong


def _linked(site: Site, sweep: subprocess.Popen[bytes]) -> list[str]:
    """A link to somebody else's results is put in its place."""
    with _away(site):
        site.out.symlink_to(site.another.absolute())
        wrong = _notices(sweep)
        site.out.unlink()
    return wrong


def _linked_lock(site: Site, sweep: subprocess.Popen[bytes]) -> list[str]:
    """The lock becomes a link to somebody else's file; then a sweep is started."""
    lock = site.out / LOCK
    lock.unlink(missing_ok=True)
    lock.symlink_to((site.another / "thesis.tex").absolute())
    wrong = _refused(site, "must be a plain file of one name")
    wrong += _notices(sweep)
    lock.unlink()
    return wrong


def _foreign_run(site: Site, sweep: subprocess.Popen[bytes]) -> list[str]:
    """A run of somebody else's results is put among its own."""
    del sweep
    [run] = site.another.glob("runs/srl/*")
    there = site.out / "runs" / "srl" / "seed-0099"
    shutil.copytree(run, there)
    _rewrite(there / "run.json", lambda document: document.update(seed=99))
    wrong = [] if _foreign_runs(site.out) == ["runs are refused"] else ["a foreign run was read"]
    shutil.rmtree(there)
    return wrong


def _twice(site: Site, sweep: subprocess.Popen[bytes]) -> list[str]:
    """The same sweep is started once more."""
    return _refused(site, "is in use by process") if sweep.poll() is None else []


def _twice_otherwise(site: Site, sweep: subprocess.Popen[bytes]) -> list[str]:
    """A sweep of another config is started in the folder."""
    said = "is in use by process" if sweep.poll() is None else "made with another config"
    return _refused(site, said, "--warmup-steps", str(_OTHER_WARMUP))


_DISTURBANCES: dict[str, Callable[[Site, subprocess.Popen[bytes]], list[str]]] = {
    "moved away": _moved,
    "another put in its place": _replaced,
    "a link put in its place": _linked,
    "its lock a link": _linked_lock,
    "a foreign run put in": _foreign_run,
    "started twice": _twice,
    "another config started in it": _twice_otherwise,
}


@contextlib.contextmanager
def _away(site: Site) -> Iterator[None]:
    """Moves the folder away, and back at the end."""
    site.out.rename(site.aside)
    try:
        yield
    finally:
        site.aside.rename(site.out)


def _notices(sweep: subprocess.Popen[bytes]) -> list[str]:
    """What is wrong unless a sweep ends soon, and not as if all were well."""
    if not _ended(sweep, _PATIENCE):
        return ["the sweep noticed nothing"]
    return [] if sweep.returncode in (1, 2) else [f"the sweep ended with {sweep.returncode}"]


def _refused(site: Site, said: str, *options: str) -> list[str]:
    """What is wrong unless another start is refused."""
    log = site.out.with_suffix(".log")
    told = log.stat().st_size
    with site.start(*options) as second:
        code = second.wait()
    text = log.read_bytes()[told:].decode(errors="replace")
    return [] if code == 2 and said in text else [f"a second start ended with {code}: {text!r}"]


def _foreign_runs(out: pathlib.Path) -> list[str]:
    """Whether the folder's runs are refused."""
    folder = ResultsFolder(out)
    try:
        for _ in range(2):  # A run may be written while they are read.
            folder.load_all()
    except ResultsError as error:
        return ["runs are refused"] if "another config" in str(error) else [str(error)]
    return []


def _works(site: Site, sweep: subprocess.Popen[bytes]) -> bool:
    """Waits until a sweep has its folder; False if it ends before."""
    while not _ended(sweep, 0.02):
        with contextlib.suppress(OSError):
            if f"process {sweep.pid} " in (site.out / LOCK).read_text(encoding="utf-8"):
                return True
    return False


def _ended(sweep: subprocess.Popen[bytes], seconds: float) -> bool:
    end = time.monotonic() + seconds
    with contextlib.suppress(subprocess.TimeoutExpired):
        sweep.wait(max(end - time.monotonic(), 0.01))
    return sweep.returncode is not None
