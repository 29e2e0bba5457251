"""What a learner's configuration costs and gives: `hitl-jax tuning`.

Every configuration gets the same ticks (environment steps, and a tick for each reset), seeds and
methods; the seeds are none of those that a sweep reports. What is done is kept, and skipped when
the command is given again.
"""

import functools
import json
import pathlib
from typing import Any

from hitl_jax.console.cli import BadInput, checking_input
from hitl_jax.console.output import say
from hitl_jax.envs import require_backend
from hitl_jax.results.atomic_files import write_text_atomic
from hitl_jax.studies.tuning.measure import measure
from hitl_jax.studies.tuning.options import BASE, CONFIGURATIONS, TuningOptions
from hitl_jax.studies.tuning.table import asked_of, is_done, table, write
from hitl_jax.sweep.changes import changed
from hitl_jax.sweep.compile_cache import keep_programs


def main(options: TuningOptions) -> int:
    """Runs the configurations that are not done yet; prints and writes the table of all."""
    out = pathlib.Path(options.out)
    with checking_input():
        options.checked()
        try:
            out.mkdir(parents=True, exist_ok=True)
            write_text_atomic(out / "tuning.md", table(out, options))
        except OSError as error:
            raise BadInput(f"--out {options.out}: {error.strerror}") from error
    keep_programs()
    for name in options.configurations:
        parts = changed(BASE | CONFIGURATIONS[name])
        asked, path = asked_of(parts, options), out / f"{name}.json"
        if is_done(path, asked):
            continue
        with checking_input():
            require_backend("lean")
        write(path, asked, *measure(parts, options, functools.partial(_tell, name)))
        write_text_atomic(out / "tuning.md", table(out, options))
    print(table(out, options))
    return 0


def _tell(name: str, stage: dict[str, Any]) -> None:
    say(f"{name} {json.dumps(stage)}")
