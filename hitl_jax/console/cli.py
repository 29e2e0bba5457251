"""Command lines: a dataclass of options in, one clear line and exit code 2 for bad input."""

import contextlib
import io
import os
import sys
import typing
from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypeVar

import tyro

from hitl_jax.analysis.figure_style import Drawn
from hitl_jax.console.refused_words import one_line
from hitl_jax.errors import InvalidValue, LaunchError, ResultsError, WalkerError

T = TypeVar("T")


class BadInput(Exception):
    """One line that names the option, the value and what is allowed."""


def run_main(name: str, main: Callable[[Any], int], args: Sequence[str]) -> int:
    """Parses the command line and runs `main`.

    Bad input is one line on stderr and exit code 2. So is, with exit code 1, what the system
    refuses in mid-work; what a walker's process died of is followed by the end of its log.

    Args:
        name: of the command.
        main: does the work and returns an exit code; may raise BadInput. The type of its argument
            is a dataclass of options.
        args: the words after the command's name.
    """
    try:
        options = typing.get_type_hints(main)["options"]
        return main(parse(options, args, f"hitl-jax {name}"))
    except BadInput as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except (ResultsError, WalkerError, LaunchError) as error:
        print("\n".join([f"error: {error}", *getattr(error, "__notes__", [])]), file=sys.stderr)
        return 1
    except OSError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("\nStopped at once.", file=sys.stderr)
        return 130


def print_drawn(drawn: Drawn) -> int:
    """Tells what was drawn and what not; the exit code, 1 if a figure could not be drawn."""
    for line in drawn.lines:
        print(line)
    return 1 if drawn.failures else 0


def option(name: str) -> str:
    """The option for a value of the library: `--human.mistake-rate` for `human.mistake_rate`."""
    return "--" + name.replace("_", "-")


@contextlib.contextmanager
def refusing(results: str = "") -> Iterator[None]:
    """Turns a ResultsError into BadInput; also for work that reads a folder as it goes on.

    Args:
        results: the option that names the folder.
    """
    try:
        yield
    except InvalidValue as error:
        raise BadInput(_joined(error.text(option))) from error
    except ResultsError as error:
        raise BadInput(f"{results} {error}".strip()) from error


@contextlib.contextmanager
def checking_input(results: str = "") -> Iterator[None]:
    """Turns what the library says of a bad value into BadInput; only for checks, not for work.

    Args:
        results: the option that names the folder of which a ResultsError tells.
    """
    try:
        with refusing(results):
            yield
    except (ValueError, ImportError) as error:
        raise BadInput(_joined(str(error))) from error


def _joined(text: str) -> str:
    return " ".join(text.split())


def parse(options: type[T], args: Sequence[str], prog: str = "hitl-jax") -> T:
    """The options of a command line; what is not given is as `options.defaults` says, if it does.

    tyro explains a bad command line in a framed box; this says the same in one line. The box is
    made once more for that, so wide that nothing in it is cut, and plain whatever the terminal is.

    Raises:
        BadInput: what is wrong, in one line.
    """
    defaults: Callable[[Sequence[str]], T] | None = getattr(options, "defaults", None)
    given: dict[str, Any] = {"args": args, "prog": prog}
    if defaults is not None:
        with checking_input():
            given["default"] = defaults(args)
    try:
        with contextlib.redirect_stderr(io.StringIO()), checking_input():
            return tyro.cli(options, **given)
    except SystemExit as stop:
        if stop.code in (0, None):
            raise
    said = io.StringIO()
    no_terminal = io.TextIOWrapper(io.BytesIO(), encoding="utf-8")  # Its encoding frames the box.
    with (
        _terminal_width(10**6),
        contextlib.redirect_stdout(no_terminal),
        contextlib.redirect_stderr(said),
        contextlib.suppress(SystemExit),
    ):
        tyro.cli(options, **given)
    raise BadInput(one_line(said.getvalue(), args))


@contextlib.contextmanager
def _terminal_width(columns: int) -> Iterator[None]:
    """What `shutil.get_terminal_size` tells within a `with`."""
    before = os.environ.get("COLUMNS")
    os.environ["COLUMNS"] = str(columns)
    try:
        yield
    finally:
        os.environ.pop("COLUMNS")
        if before is not None:
            os.environ["COLUMNS"] = before
