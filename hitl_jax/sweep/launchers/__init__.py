"""Where batches of runs are made: in this process, or on the machines of a Ray cluster."""

import contextlib
import dataclasses
import pathlib
from collections.abc import Callable, Collection, Generator, Iterator, Sequence
from typing import Protocol

from hitl_jax.choices.checks import one_of
from hitl_jax.errors import InvalidValue
from hitl_jax.results.run_key import RunKey
from hitl_jax.sweep.launchers.cluster import connected
from hitl_jax.sweep.launchers.local import Local
from hitl_jax.sweep.launchers.on_ray import OnRay
from hitl_jax.sweep.train_and_test import Batch, Tested
from hitl_jax.training.run_spec import Run

LAUNCHERS = ("local", "ray")


class Launcher(Protocol):
    """Makes batches of runs."""

    def make(
        self, batches: Sequence[Batch], show: Callable[[Sequence[Run]], None]
    ) -> Generator[Tested]:
        """Gives each run as it ends, tested, in any order.

        Args:
            batches: the runs; one without runs has nothing left to do.
            show: is told now and then how the runs that are under way stand.

        Raises:
            Interrupted: after Ctrl-C or SIGTERM, when what can be kept is kept.
        """
        ...


@dataclasses.dataclass(frozen=True)
class LaunchOptions:
    """Where runs are made.

    Attributes:
        launcher: `local`, this machine; `ray`, the machines of a Ray cluster (needs the extra
            `ray`).
        ray_address: of a running cluster, `HOST:PORT`, or `auto` on one of its machines (default:
            one of this machine alone, for as long as the command runs).
    """

    launcher: str = "local"
    ray_address: str | None = None

    def checked(self) -> "LaunchOptions":
        """Checks what can be checked without a cluster; returns itself.

        Raises:
            InvalidValue: one line with the name, the value and what is allowed.
        """
        one_of("launcher", self.launcher, LAUNCHERS)
        if self.ray_address is not None and self.launcher != "ray":
            raise InvalidValue(
                "ray_address", self.ray_address, "needs launcher ray", mentions=("launcher",)
            )
        return self

    @property
    def goes_on(self) -> str:
        """What the same command does after it was stopped."""
        if self.launcher == "ray":
            return "The same command makes the runs that are missing, each from its beginning."
        return "The same command goes on where it was."

    @contextlib.contextmanager
    def ready(self) -> Iterator[None]:
        """Connects to the cluster, if one is asked for, and leaves it at the end.

        Raises:
            InvalidValue: one line, if there is none, or with the extra to install.
        """
        with connected(self.ray_address) if self.launcher == "ray" else contextlib.nullcontext():
            yield

    def make(
        self,
        folder: pathlib.Path,
        save_seconds: float,
        finished: Callable[[], Collection[RunKey]],
        say: Callable[[str], None],
    ) -> Launcher:
        """The launcher, to be used while it is `ready`.

        Args:
            folder: where what is under way may be saved.
            save_seconds: how often [s].
            finished: the runs that are kept.
            say: prints a line.
        """
        if self.launcher == "ray":
            return OnRay(folder, finished, say)
        return Local(folder, save_seconds, finished, say)
