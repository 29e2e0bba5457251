"""Judgements of a person, step by step, as a file: what `--human recorded:FILE` reads."""

import hashlib
import io
import pathlib

import numpy as np

from hitl_jax.files import write_bytes_atomic
from hitl_jax.human import HumanPart, recorded

SIMULATED = "simulated"
PREFIX = "recorded:"
_IN_FOLDER = "human.npz"


def write(path: pathlib.Path, dangerous: np.ndarray) -> None:
    """Writes h_t = 0 of each step, bool [T].

    Raises:
        ResultsError: if it cannot be written.
    """
    file = io.BytesIO()
    np.savez_compressed(file, allow_pickle=False, dangerous=dangerous)
    write_bytes_atomic(path, file.getvalue())


def load(human: str) -> np.ndarray | None:
    """The judgements that an option names, bool [T]; None for the simulated human.

    Args:
        human: `simulated` or `recorded:FILE`.

    Raises:
        ValueError: one line naming the option.
    """
    if human == SIMULATED:
        return None
    if not human.startswith(PREFIX):
        raise ValueError(f"--human {human}: must be {SIMULATED} or {PREFIX}FILE")
    return _read(pathlib.Path(human.removeprefix(PREFIX)), human)


def digest(dangerous: np.ndarray | None) -> dict[str, str]:
    """What a results folder's configuration says of the human; nothing of the simulated one."""
    if dangerous is None:
        return {}
    return {"human": "sha256:" + hashlib.sha256(dangerous.tobytes()).hexdigest()}


def keep(folder: pathlib.Path, dangerous: np.ndarray | None) -> None:
    """Keeps a recorded human with the results that it had a part in."""
    if dangerous is not None:
        write(folder / _IN_FOLDER, dangerous)


def load_kept(folder: pathlib.Path) -> np.ndarray | None:
    """What `keep` has kept, bool [T]; None where the human was simulated.

    Raises:
        ValueError: one line, if the file is damaged.
    """
    path = folder / _IN_FOLDER
    return _read(path, PREFIX + str(path)) if path.exists() else None


def kept(folder: pathlib.Path) -> HumanPart | None:
    """The recorded human of results; None where it was simulated.

    Raises:
        ValueError: one line, if the file is damaged.
    """
    dangerous = load_kept(folder)
    return None if dangerous is None else recorded(dangerous)


def _read(path: pathlib.Path, human: str) -> np.ndarray:
    try:
        with np.load(path, allow_pickle=False) as archive:
            dangerous: np.ndarray = archive["dangerous"]
    except Exception as error:  # A flipped bit can make of zipfile's and NumPy's errors any.
        raise ValueError(f"--human {human}: is no file of `hitl-jax recorded`") from error
    if dangerous.dtype != bool or dangerous.ndim != 1:
        raise ValueError(f"--human {human}: its judgements are no bool [T]")
    return dangerous
