"""Where numbers come from: versions, the commit of this code, the machine."""

import importlib.metadata
import pathlib
import platform
import subprocess
from typing import Any

_PACKAGES = (
    "jax",
    "jaxlib",
    "flax",
    "optax",
    "chex",
    "brax",
    "gymnasium",
    "box2d",
    "box2d-py",
    "envpool",
    "numpy",
)


def versions() -> dict[str, str]:
    """Versions of Python and of the packages that a run's numbers depend on.

    Read from the packages' metadata, so that none is imported; one that is not installed is absent.
    gymnasium's Box2D is published under two names, `box2d` and `box2d-py`.
    """
    found = {"python": platform.python_version()}
    for name in _PACKAGES:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return found


def git_commit() -> str | None:
    """The commit of this code, with "-dirty" after it where tracked files have changed.

    Returns:
        None without git, without a commit, or where this file is not part of the repository around
        it (a package installed below somebody else's checkout).
    """
    here = pathlib.Path(__file__).resolve()
    try:
        _git(here.parent, "ls-files", "--error-unmatch", here.name)
        return _git(here.parent, "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*")
    except (OSError, subprocess.SubprocessError):
        return None


def origin() -> dict[str, Any]:
    """What numbers that are made here depend on: `versions`, `commit` and `processor`."""
    return {"versions": versions(), "commit": git_commit(), "processor": processor()}


def processor() -> str:
    """The processor's name, in one line."""
    try:
        with open("/proc/cpuinfo", encoding="utf-8", errors="replace") as lines:
            names = [line.partition(":")[2].strip() for line in lines if "model name" in line]
    except OSError:
        names = []
    name = names[0] if names else platform.processor() or platform.machine()
    # Or the results of hours could not be read back: they may hold no control characters.
    return "".join(letter if letter.isprintable() else " " for letter in name).strip()


def short_commit(commit: str | None) -> str:
    """What `git_commit` gave, in a few characters for a table."""
    if commit is None:
        return "unknown"
    if "+" in commit:  # Of a run that was taken up by other code.
        return "+".join(map(short_commit, commit.split("+")))
    digits, *dirty = commit.split("-")
    return "-".join([digits[:7], *dirty])


def _git(folder: pathlib.Path, *arguments: str) -> str:
    done = subprocess.run(
        ["git", *arguments],
        cwd=folder,
        capture_output=True,
        encoding="utf-8",
        errors="replace",
        check=True,
        timeout=30,
    )
    return done.stdout.strip()
