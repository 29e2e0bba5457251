"""Checks that Box2D and gymnasium's walker can be imported, and says in one line if not."""

import contextlib
import functools
import importlib
import warnings
from collections.abc import Iterator

_INSTALL = 'pip install "gymnasium[box2d]"'


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Ignores the warnings of Box2D's import (of SWIG); as errors they would end the process."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


@functools.cache
def missing() -> str | None:
    """Why Box2D cannot be imported, in one line; None where it can be."""
    return _reason("Box2D")


def require(what: str) -> None:
    """Raises if Box2D cannot be imported.

    Args:
        what: name of what needs it, for the message.

    Raises:
        ImportError: one line that says what to install.
    """
    if reason := missing():
        raise ImportError(f"{what} needs Box2D ({reason}): {_INSTALL}")


def require_gymnasium(what: str) -> None:
    """Raises if gymnasium's own walker cannot be imported.

    Args:
        what: name of what needs it, for the message.

    Raises:
        ImportError: one line that says what to install.
    """
    require(what)
    if reason := _reason("gymnasium.envs.box2d.bipedal_walker"):
        raise ImportError(f"{what} needs gymnasium's BipedalWalker ({reason}): {_INSTALL}")


def _reason(module: str) -> str | None:
    """Why a module cannot be imported, in one line; None if it can be."""
    try:
        with quiet():
            importlib.import_module(module)
    except Exception as error:  # Gymnasium raises its own errors for missing packages.
        return " ".join(str(error).split()) or type(error).__name__
    return None
