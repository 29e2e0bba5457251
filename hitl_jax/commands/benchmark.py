"""How near each part is to what this machine can do: `hitl-jax benchmark`.

Every ratio is of two figures of one run, since machines differ and are noisy. Let nothing else run
beside it. `scaling`, `saves`, `walkers`, `live`, `launchers` and `peers` take some minutes each.
"""

import dataclasses
import json
import os
import pathlib
from collections.abc import Callable
from typing import Any

from hitl_jax.benchmarks.launchers import measure_launchers
from hitl_jax.benchmarks.learner import measure_learner
from hitl_jax.benchmarks.live import measure_live
from hitl_jax.benchmarks.loop import measure_loop
from hitl_jax.benchmarks.peers import measure_peers
from hitl_jax.benchmarks.pool import measure_pool
from hitl_jax.benchmarks.saves import measure_saves
from hitl_jax.benchmarks.scaling import draw_scaling, measure_scaling
from hitl_jax.benchmarks.walkers import measure_walkers
from hitl_jax.console.cli import checking_input
from hitl_jax.console.timing import Row, print_rows
from hitl_jax.envs import box2d
from hitl_jax.errors import BadInput
from hitl_jax.results.atomic_files import write_text_atomic
from hitl_jax.results.provenance import versions
from hitl_jax.xla.cores import num_cores

_ON_GYMNASIUM = ("pool", "peers")
_ON_BOX2D = ("loop", "scaling", "saves", "live")
"""Parts that need it: `learner` has no walkers, `walkers` tells which it did not find."""


@dataclasses.dataclass(frozen=True)
class BenchmarkOptions:
    """Measure learner, walkers and loop on this machine, their growth with runs, and their peers.

    Attributes:
        only: parts to measure: some of learner, pool, loop, scaling, saves, walkers, live (which
            needs the extra `live`), launchers (which needs the extra `ray`), peers (which needs the
            extra `bench`).
        json: a file for the same numbers.
        plot: a .png or .svg file for a picture of the part scaling.
        seconds: time for one measurement [s].
    """

    only: tuple[str, ...] = (
        *("learner", "pool", "loop", "scaling", "saves", "walkers", "live", "launchers", "peers"),
    )
    json: str | None = None
    plot: str | None = None
    seconds: float = 2.0


def main(options: BenchmarkOptions) -> int:
    """Measures, prints a table a part, and writes JSON if asked."""
    parts = [part for given in options.only for part in given.split(",")]
    if not parts or not PARTS.keys() >= set(parts):
        raise BadInput(f"--only {' '.join(options.only)}: must be some of {', '.join(PARTS)}")
    if not options.seconds > 0:
        raise BadInput(f"--seconds {options.seconds}: must be above 0")
    for name, file in (("json", options.json), ("plot", options.plot)):
        if file is not None and not pathlib.Path(file).resolve().parent.is_dir():
            raise BadInput(f"--{name} {file}: its folder does not exist")
    if options.plot is not None:
        if pathlib.Path(options.plot).suffix not in (".png", ".svg"):
            raise BadInput(f"--plot {options.plot}: must end with .png or .svg")
        if "scaling" not in parts:
            raise BadInput(f"--plot {options.plot}: needs the part scaling in --only")
    with checking_input():
        for part in parts:
            if part in _ON_GYMNASIUM:
                box2d.require_gymnasium(f"--only {part}")
            if part in _ON_BOX2D:
                box2d.require(f"--only {part}")
    # Of a GPU, take what is needed: the processes of the part scaling need the rest.
    os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")
    report: dict[str, Any] = {"versions": versions(), "cores": num_cores()}
    for part in parts:
        rows = PARTS[part](options)
        report[part] = rows
        print_rows(part, rows)
        if options.json is not None:
            write_text_atomic(pathlib.Path(options.json), json.dumps(report, indent=2) + "\n")
        if options.plot is not None and part == "scaling":
            draw_scaling(rows, options.plot)
    return 0


PARTS: dict[str, Callable[[BenchmarkOptions], list[Row]]] = {
    "learner": lambda options: measure_learner(options.seconds),
    "pool": lambda options: measure_pool(options.seconds),
    "loop": lambda options: measure_loop(options.seconds),
    "scaling": lambda options: measure_scaling(options.seconds),
    "saves": lambda options: measure_saves(options.seconds),
    "walkers": lambda options: measure_walkers(options.seconds),
    "live": lambda options: measure_live(options.seconds),
    "launchers": lambda options: measure_launchers(options.seconds),
    "peers": lambda options: measure_peers(options.seconds),
}
