"""How near each part is to what this machine can do: `hitl-jax benchmark`.

Every ratio is of two figures of one run, since machines differ and are noisy. Let nothing else run
beside it. `scaling`, `saves`, `walkers`, `live`, `launchers` and `peers` take some minutes each.
"""

import dataclasses
import json
import os
import pathlib
from typing import Any

from hitl_jax.benchmarks.parts import PARTS, require_walkers
from hitl_jax.benchmarks.scaling import draw_scaling
from hitl_jax.console.cli import BadInput, checking_input
from hitl_jax.console.output import print_rows
from hitl_jax.results.atomic_files import write_text_atomic
from hitl_jax.results.provenance import versions
from hitl_jax.xla.cores import num_cores


@dataclasses.dataclass(frozen=True)
class BenchmarkOptions:
    """Measure learner, walkers and loop on this machine, their growth with runs, and their peers.

    Attributes:
        only: parts to measure: some of learner, pool, loop, scaling, saves, logs (of the extra
            `log`), walkers, live (which needs the extra `live`), launchers (which needs the extra
            `ray`), peers (which needs the extra `bench`).
        json: a file for the same numbers.
        plot: a .png or .svg file for a picture of the part scaling.
        seconds: time for one measurement [s].
    """

    only: tuple[str, ...] = (
        *("learner", "pool", "loop", "scaling", "saves", "logs", "walkers", "live", "launchers"),
        "peers",
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
        require_walkers(parts, "--only {}".format)
    # Of a GPU, take what is needed: the processes of the part scaling need the rest.
    os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")
    report: dict[str, Any] = {"versions": versions(), "cores": num_cores()}
    for part in parts:
        rows = PARTS[part](options.seconds)
        report[part] = rows
        print_rows(part, rows)
        if options.json is not None:
            write_text_atomic(pathlib.Path(options.json), json.dumps(report, indent=2) + "\n")
        if options.plot is not None and part == "scaling":
            for failure in draw_scaling(rows, options.plot):
                print(failure)
    return 0
