"""The report: `hitl-jax report` rebuilds it, and every figure, from saved data."""

import dataclasses
import pathlib

from hitl_jax.console.cli import refusing
from hitl_jax.console.output import say
from hitl_jax.reports.report import write_report


@dataclasses.dataclass(frozen=True)
class ReportOptions:
    """Rebuilds REPORT.md, the summaries, the tables and the figures of a folder of results.

    Attributes:
        results: the folder, with `full`, `steady_noise`, `fading`, `ten_seeds`, `paper`,
            `foresight_ddpg`, `foresight_120`, `foresight_160`, `ablations`, `network` and
            `tuning` in it, and what people wrote of the scope (`scope.md`); what is missing is said
            in the report.
    """

    results: str = "results"


def main(options: ReportOptions) -> int:
    """Writes everything.

    Args:
        options: where.

    Returns:
        The exit code.
    """
    with refusing(results="--results"):
        path = write_report(pathlib.Path(options.results), say)
    print(path)
    return 0
