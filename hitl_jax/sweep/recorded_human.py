"""Judgements of a person, step by step, as a file: what `--human recorded:FILE` reads."""

import hashlib
import pathlib

import numpy as np

from hitl_jax.errors import InvalidValue, ResultsError
from hitl_jax.human.judgement import HumanPart, recorded
from hitl_jax.results.atomic_files import read_bytes, write_bytes_atomic
from hitl_jax.results.folder import ResultsFolder
from hitl_jax.results.npz_archives import Form, from_npz, to_npz

SIMULATED = "simulated"
PREFIX = "recorded:"
_IN_FOLDER = "human.npz"
_MOST_STEPS = 2**26
"""That a person may have judged."""


def write(path: pathlib.Path, dangerous: np.ndarray) -> None:
    """Writes h_t = 0 of each step, bool [T].

    Raises:
        ResultsError: if it cannot be written.
    """
    write_bytes_atomic(path, to_npz({"dangerous": dangerous}, np.savez_compressed))


def load(human: str) -> np.ndarray | None:
    """The judgements that an option names, bool [T]; None for the simulated human.

    Args:
        human: `simulated` or `recorded:FILE`.

    Raises:
        InvalidValue: in one line.
    """
    if human == SIMULATED:
        return None
    if not human.startswith(PREFIX):
        raise InvalidValue("human", human, f"must be {SIMULATED}, {PREFIX}FILE or fitted:FILE")
    return _read(pathlib.Path(human.removeprefix(PREFIX)), human)


def digest(dangerous: np.ndarray | None) -> dict[str, str]:
    """What a results folder's configuration says of the human; nothing of the simulated one."""
    if dangerous is None:
        return {}
    return {"human": "sha256:" + hashlib.sha256(dangerous.tobytes()).hexdigest()}


def save_to_results(folder: pathlib.Path, dangerous: np.ndarray | None) -> None:
    """Keeps a recorded human with the results that it had a part in."""
    if dangerous is not None:
        write(folder / _IN_FOLDER, dangerous)


def load_from_results(folder: ResultsFolder) -> HumanPart | None:
    """The recorded human of results; None where it was simulated.

    Raises:
        ValueError: one line, if the file is missing, damaged or another.
    """
    dangerous = load_kept(folder)
    return None if dangerous is None else recorded(dangerous)


def load_kept(folder: ResultsFolder) -> np.ndarray | None:
    """What `save_to_results` has kept, bool [T]; None where the human was simulated.

    Raises:
        ValueError: one line, if the file is missing, damaged or another.
    """
    made_with = folder.load_config().get("human")
    if made_with is None:
        return None
    path = folder.path / _IN_FOLDER
    dangerous = _read(path, PREFIX + str(path))
    if digest(dangerous) != {"human": made_with}:
        raise ValueError(f"{path}: is not the human that {folder.path} was made with")
    return dangerous


def _read(path: pathlib.Path, human: str) -> np.ndarray:
    def require(forms: dict[str, Form]) -> None:
        [dangerous] = forms.values()
        if "dangerous" not in forms or dangerous.dtype != bool or len(dangerous.shape) != 1:
            raise ValueError("its judgements are no bool [T]")

    try:
        return from_npz(read_bytes(path, _MOST_STEPS), _MOST_STEPS, require)["dangerous"]
    except ResultsError as error:
        raise InvalidValue("human", path, str(error).removeprefix(f"{path}: ")) from error
    except ValueError as error:
        raise InvalidValue("human", human, "is no file of `hitl-jax recorded`") from error
