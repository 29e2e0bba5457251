"""What tuning has measured: a file for each configuration, and a table of those of one budget."""

import dataclasses
import json
import pathlib
from typing import Annotated, Any

import msgspec
import numpy as np

from hitl_jax.analysis import markdown
from hitl_jax.config import AgentConfig, Hyper, Method
from hitl_jax.results.atomic_files import read_bytes, write_text_atomic
from hitl_jax.results.config_diff import compared, completed
from hitl_jax.results.json_documents import checked, options_of, plain_from_json
from hitl_jax.results.provenance import git_commit, short_commit
from hitl_jax.results.schemas import Config, Count, Positive, Text
from hitl_jax.studies.tuning.options import TuningOptions
from hitl_jax.sweep.changes import Parts
from hitl_jax.training.run_spec import LoopConfig


def asked_of(parts: Parts, options: TuningOptions) -> dict[str, Any]:
    """What defines the numbers of a configuration, as it is read back from its file."""
    asked = {
        "budget": options.budget,
        "agent": dataclasses.asdict(parts.agent),
        "loop": dataclasses.asdict(parts.loop),
        "hyper": dataclasses.asdict(parts.hyper),
    }
    as_read: dict[str, Any] = json.loads(json.dumps(asked))
    return as_read


def is_done(path: pathlib.Path, asked: dict[str, Any]) -> bool:
    """Whether a file holds what is asked for."""
    known = load(path)
    return known is not None and compared(known["asked"]) == compared(asked)


def write(
    path: pathlib.Path,
    asked: dict[str, Any],
    stages: list[dict[str, Any]],
    tests: dict[str, list[float]],
) -> None:
    """Writes what a configuration has brought; see `measure`."""
    done = {"asked": asked, "commit": git_commit(), "stages": stages, "tests": tests}
    write_text_atomic(path, json.dumps(done, indent=1, allow_nan=False) + "\n")


def load(path: pathlib.Path) -> dict[str, Any] | None:
    """What `write` has written to a file; None where it has not."""
    try:
        data: dict[str, Any] = plain_from_json(read_bytes(path), dict[str, Any])
        checked(data, _Tuned)
        for name, kind in (("agent", AgentConfig), ("loop", LoopConfig), ("hyper", Hyper)):
            options_of(completed(data["asked"])[name], kind)
    except ValueError:
        return None
    return data


_Measured = Annotated[float, msgspec.Meta(ge=-1e30, le=1e30)]


class _Budget(msgspec.Struct):
    seeds: Positive
    first_seed: Count
    ticks: Positive
    test_episodes: Positive


class _Asked(msgspec.Struct):
    budget: _Budget
    agent: Config
    loop: Config
    hyper: Config


class _Stage(msgspec.Struct, rename="kebab"):
    ticks: Positive
    seconds: Annotated[float, msgspec.Meta(gt=0.0)]
    srl: list[_Measured]
    hitl_fix: list[_Measured]
    hitl_ac: list[_Measured]


_Returns = Annotated[list[_Measured], msgspec.Meta(min_length=1)]


class _Tests(msgspec.Struct, rename="kebab"):
    srl: _Returns
    hitl_fix: _Returns
    hitl_ac: _Returns


class _Tuned(msgspec.Struct):
    """What is written of a configuration."""

    asked: _Asked
    commit: Text | None
    stages: Annotated[list[_Stage], msgspec.Meta(min_length=1)]
    tests: _Tests


def table(out: pathlib.Path, options: TuningOptions) -> str:
    """Markdown: a row for each configuration in the folder that had the same budget.

    Args:
        out: the folder.
        options: the budget.
    """
    head = ["configuration", "commit", "ticks/s, all runs"]
    for method in Method:
        head += [f"{method}: training by thirds", f"{method}: test (least to most)"]
    lines = [head]
    for path in sorted(out.glob("*.json")):
        data = load(path)
        if data is None or data["asked"]["budget"] != options.budget:
            continue
        warmup = data["asked"]["hyper"]["warmup_steps"]
        last, runs = data["stages"][-1], sum(map(len, data["tests"].values()))
        rate = max(last["ticks"] - warmup, 0) * runs / last["seconds"]
        row = [path.stem, short_commit(data["commit"]), f"{rate:,.0f}"]
        for method in Method:
            tests = data["tests"][method]
            thirds = [stage[method] for stage in data["stages"]]
            row.append(", ".join(f"{np.mean(third):.0f}" if third else "–" for third in thirds))
            row.append(f"{np.mean(tests):.0f} ({min(tests):.0f} to {max(tests):.0f})")
        lines.append(row)
    return markdown.table(lines)
