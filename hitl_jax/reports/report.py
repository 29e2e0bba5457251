"""The report, rebuilt with every figure from saved data.

Each number in it is computed here from the folders of results. Run on what is committed, it
changes nothing.
"""

import pathlib
import shlex
from collections.abc import Callable

import numpy as np

from hitl_jax.analysis import boundary_map
from hitl_jax.analysis.figures import draw_all
from hitl_jax.analysis.markdown import table
from hitl_jax.analysis.summary import write_summary
from hitl_jax.config import Hyper
from hitl_jax.errors import ResultsError
from hitl_jax.playback.load_trained import section_of
from hitl_jax.reports.ablations import ablations
from hitl_jax.reports.comparison import Compared, at_a_glance, compare, in_brief
from hitl_jax.reports.cost import cost_of_choices
from hitl_jax.reports.foresight import foresight
from hitl_jax.results.atomic_files import named_errors, read_bytes, write_text_atomic
from hitl_jax.results.config_diff import flatten
from hitl_jax.results.folder import ResultsFolder
from hitl_jax.studies.tuning.options import TuningOptions
from hitl_jax.studies.tuning.table import table as table_of_tuning

_NETWORK = "network"
_SCOPE = "scope.md"
"""What a program cannot say on the report's first pages; it is taken as it is."""
_COMPARISONS = (
    Compared("the defaults", "full"),
    Compared("`--noise-steps 0 --tested-actor last`", "steady_noise"),
    Compared("`--tested-actor last`", "fading"),
    Compared("`--preset paper --learner td3-tqc`", "ten_seeds"),
    Compared("`--preset paper`", "paper"),
)


_HEAD = """\
# Report

Does what the paper claims hold here, by how much, and what makes it hold? Written by
`hitl-jax report` from the data in this folder; [README.md](README.md) has what a
program cannot say.

A claim *holds* or *does not hold* by a rule, which the sections on the three methods name in the
column "to hold". It is *not decided* where the interval allows both, or where it holds in some
resamples of the seeds (2.5 to 97.5 %) and not in others. Numbers in brackets are bootstrap 95 %
intervals over seeds; with five seeds they are rough. The resamples are the same everywhere, so a
number has one interval in all tables. "Solved" is a return of 300.
"""


def write_report(root: pathlib.Path, say: Callable[[str], None]) -> pathlib.Path:
    """Writes the report, and all tables and figures that it shows.

    Args:
        root: the folder of results; what is missing in it is said in the report.
        say: is told which figures could not be drawn, and why.

    Returns:
        The report's path.

    Raises:
        ResultsError: if there are no results, or if they are damaged or cannot be written.
    """
    if not (any(root.glob("*/config.json")) or (root / "ablations" / "runs.csv").exists()):
        raise ResultsError(f"{root}: holds no results")
    scope = _scope(root / _SCOPE)
    compared = [compare(each, root, say) for each in _COMPARISONS]
    parts = [_HEAD, in_brief(compared), scope]
    parts += [cost_of_choices(root), at_a_glance(compared)]
    parts += [each.text for each in compared]
    parts += [foresight(root, say, [comparison.folder for comparison in _COMPARISONS])]
    parts += [ablations(root / "ablations", say), _map(root / _NETWORK, say)]
    parts += [_tuning(root / "tuning"), _settings(root)]
    path = root / "REPORT.md"
    write_text_atomic(path, "\n".join(parts))
    return path


def _scope(path: pathlib.Path) -> str:
    """What people wrote of the report's scope."""
    if not path.exists():
        return ""
    with named_errors(path):
        return read_bytes(path).decode()


def _tuning(folder: pathlib.Path) -> str:
    title = "## Tuning\n"
    options = TuningOptions()
    names = shlex.join(sorted(path.stem for path in folder.glob("*.json")))
    if not names:
        return f"{title}\nNone kept.\n"
    seeds = f"{options.first_seed} to {options.first_seed + options.seeds - 1}"
    return (
        f"{title}\nA configuration is run for all three methods: seeds {seeds}, which no "
        f"comparison above has, {options.ticks:,} ticks (steps and resets) a run, "
        f"{options.test_episodes} autonomous test episodes. The rate is of all these runs "
        "together, side by side on one machine; rates of other commits or machines do not compare. "
        "[README.md](README.md#tuning) has the configurations that were tried before.\n\n"
        f"{table_of_tuning(folder, options)}"
        f"\n    hitl-jax tuning --only {names} --out results/tuning\n"
    )


def _settings(root: pathlib.Path) -> str:
    """The options of every comparison that is there."""
    title = "## Settings\n"
    configs = {
        comparison.folder: flatten(ResultsFolder(root / comparison.folder).load_config())
        for comparison in _COMPARISONS
        if (root / comparison.folder).exists()
    }
    if not configs:
        return f"{title}\nNone.\n"
    names = list(dict.fromkeys(name for config in configs.values() for name in config))
    lines = [["option", *configs]]
    for name in names:
        cells = (str(config.get(name, "not there yet")) for config in configs.values())
        lines.append([name, *cells])
    return f"{title}\n{table(lines)}"


def _map(path: pathlib.Path, say: Callable[[str], None]) -> str:
    """The boundary over the state, where a network gives it."""
    title = "## The boundary over the state, with `--boundary-source network`\n"
    folder = ResultsFolder(path)
    if not (path / boundary_map.DATA).exists():
        return f"{title}\nNot run yet.\n"
    write_summary(folder)
    failures = draw_all(folder).failures
    for failure in [*failures, *boundary_map.draw(folder).failures]:
        say(failure)
    steps, boundary = boundary_map.told(folder)
    config, runs = folder.load_config(), len(folder.finished())
    hyper = section_of(folder, "hyper", Hyper)
    return (
        f"{title}\n{runs} runs of {config['episodes']} episodes; the autonomous test, "
        f"{steps.sum():,.0f} steps. The mean boundary is "
        f"{np.average(boundary, weights=steps):.2f} rad, of the cells from {boundary.min():.2f} to "
        f"{boundary.max():.2f}; its bounds are {hyper.boundary_low} and "
        f"{hyper.boundary_high}, it began at {hyper.initial_boundary}, and the human's "
        f"tolerance is {hyper.human.tolerance}. Tables: "
        f"[{path.name}/summary.md]({path.name}/summary.md).\n\n"
        f"![the boundary over hull angle and its velocity]({path.name}/figures/figure9_map.png)\n"
    )
