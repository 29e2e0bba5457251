"""Box2D and gymnasium's walker: imported late, and where missing, missed in one clear line."""

import contextlib
import functools
import importlib
import warnings
from collections.abc import Iterator

_INSTALL = 'pip install "gymnasium[box2d]"'


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Around imports of Box2D: SWIG's types warn, and as an error that ends the process."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


@functools.cache
def missing() -> str | None:
    """Why Box2D cannot be imported, in one line; None where it can be."""
    return _reason("Box2D")


def require(what: str) -> None:
    """Refuses to begin what stands on Box2D where it is missing.

    Args:
        what: needs it; as the user calls it.

    Raises:
        ImportError: one line that says what to install.
    """
    if reason := missing():
        raise ImportError(f"{what} needs Box2D ({reason}): {_INSTALL}")


def require_gymnasium(what: str) -> None:
    """Refuses to begin what stands on gymnasium's own walker where it is missing.

    Args:
        what: needs it; as the user calls it.

    Raises:
        ImportError: one line that says what to install.
    """
    require(what)
    if reason := _reason("gymnasium.envs.box2d.bipedal_walker"):
        raise ImportError(f"{what} needs gymnasium's BipedalWalker ({reason}): {_INSTALL}")


def _reason(module: str) -> str | None:
    try:
        with quiet():
            importlib.import_module(module)
    except Exception as error:  # Gymnasium has errors of its own for what is not installed.
        return " ".join(str(error).split()) or type(error).__name__
    return None
