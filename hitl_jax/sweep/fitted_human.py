"""A human who was fitted to what a person did, as a file: what `--human fitted:FILE` reads."""

import hashlib
import pathlib
from typing import NamedTuple

from hitl_jax.errors import InvalidValue, ResultsError
from hitl_jax.human import fitted
from hitl_jax.human.actions import ActionSource
from hitl_jax.human.part import HumanPart
from hitl_jax.results.atomic_files import read_bytes, write_bytes_atomic
from hitl_jax.results.folder import ResultsFolder
from hitl_jax.results.npz_archives import from_npz

PREFIX = "fitted:"
_IN_FOLDER, _IN_CONFIG = "fitted_human.npz", "fitted_human"
_MOST_BYTES = 2**26


class FittedHuman(NamedTuple):
    """Who judges and acts.

    Attributes:
        data: of the file.
        judge: their judgement.
        source: their hands; None where the file has none.
    """

    data: bytes
    judge: HumanPart
    source: ActionSource | None


def load(human: str) -> FittedHuman | None:
    """The human that an option names; None where it names another.

    Args:
        human: `fitted:FILE`, or another value of the option.

    Raises:
        InvalidValue: in one line.
    """
    if not human.startswith(PREFIX):
        return None
    return _read(pathlib.Path(human.removeprefix(PREFIX)))


def digest(human: FittedHuman | None) -> dict[str, str]:
    """What a results folder's configuration says of this human; nothing of others."""
    if human is None:
        return {}
    return {_IN_CONFIG: "sha256:" + hashlib.sha256(human.data).hexdigest()}


def save_to_results(folder: pathlib.Path, human: FittedHuman | None) -> None:
    """Keeps the human with the results that they had a part in."""
    if human is not None:
        write_bytes_atomic(folder / _IN_FOLDER, human.data)


def load_from_results(folder: ResultsFolder) -> FittedHuman | None:
    """The fitted human of results; None where another judged.

    Raises:
        ValueError: one line, if the file is missing, damaged or another.
    """
    made_with = folder.load_config().get(_IN_CONFIG)
    if made_with is None:
        return None
    path = folder.path / _IN_FOLDER
    human = _read(path)
    if digest(human) != {_IN_CONFIG: made_with}:
        raise ValueError(f"{path}: is not the human that {folder.path} was made with")
    return human


def _read(path: pathlib.Path) -> FittedHuman:
    try:
        data = read_bytes(path, _MOST_BYTES)
        arrays = from_npz(data, _MOST_BYTES)
        fitted.require_fitted(arrays)
    except ResultsError as error:
        raise InvalidValue("human", path, str(error).removeprefix(f"{path}: ")) from error
    except ValueError as error:
        raise InvalidValue("human", path, f"is no fitted human: {error}") from error
    return FittedHuman(data, fitted.judge_of(arrays), fitted.hands_of(arrays))
