"""One whole file of every format, made up."""

import dataclasses
import functools
import itertools
import json
import pathlib
from typing import Any

import compiled
import jax
import numpy as np
from live_team import setup_of

from hitl_jax.analysis import alarm_figures, assistance_figure, boundary_map, warning_figures
from hitl_jax.config import AgentConfig
from hitl_jax.live import journal
from hitl_jax.live.options import LiveOptions
from hitl_jax.live.session import Session
from hitl_jax.results.diagnostic_table import FILE as DIAGNOSTICS
from hitl_jax.results.episode_tables import EPISODE_COLUMNS, PROGRESS_COLUMNS, TEST_COLUMNS
from hitl_jax.results.folder import ResultsFolder
from hitl_jax.results.npz_archives import to_npz
from hitl_jax.results.recorded_episodes import STEP_COLUMNS, Recording
from hitl_jax.results.run_key import RunKey
from hitl_jax.studies.ablations.store import _COLUMNS
from hitl_jax.studies.tuning.options import TuningOptions
from hitl_jax.sweep import recorded_human
from hitl_jax.sweep.options import SweepOptions
from hitl_jax.sweep.run_sweep import config_of
from hitl_jax.team import agent as agents
from hitl_jax.team import checkpoint
from hitl_jax.team.agent import make_agent
from hitl_jax.training.saved_run import SavedRun
from hitl_jax.training.saved_run_store import Saves

KEY = RunKey("hitl-ac", 0)


RUN = f"runs/{KEY.method}/seed-0000"


AGENT = AgentConfig(learner="td3", hidden_sizes=(8,), batch_size=8, boundary_hidden_sizes=(4,))


EPISODES, TESTS, LENGTH = 3, 2, 5


CAPACITY = 8


SHARD = {"number": 1, "of": 2, "methods": ["srl"], "first_seed": 0, "seeds": 3}


DANGEROUS = np.arange(300) % 11 == 0


SAMPLES = [
    {"updates": 1000, "env_steps": 2000, "episodes": 1, "q": 0.5, "critic_loss": 1.25},
    {"updates": 2000, "env_steps": 4000, "episodes": 2, "q": 0.75, "critic_loss": 1.5},
]


def _fitted_human(rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Arrays of small networks: of danger, and of hands."""
    arrays = {"delay": np.array(10, np.int32), "least_expectation": np.array(0.4, np.float32)}
    for prefix, widths in (("network", (24, 8, 1)), ("actor", (24, 8, 4))):
        for place, (size, width) in enumerate(itertools.pairwise(widths)):
            head = f"{prefix}/params/Dense_{place}"
            arrays[f"{head}/kernel"] = rng.normal(size=(size, width)).astype(np.float32)
            arrays[f"{head}/bias"] = np.zeros(width, np.float32)
    return arrays


def make(root: pathlib.Path) -> None:
    """Makes a folder in which every format occurs."""
    rng = np.random.default_rng(0)
    recorded_human.write(root / "judged.npz", DANGEROUS)
    (root / "fitted.npz").write_bytes(to_npz(_fitted_human(rng)))
    config = config_of_a_sweep()
    for name in ("sweep", "old", "recorded"):
        human = human_of(name)
        folder = ResultsFolder(root / name)
        folder.create_or_resume(config | human, "hitl-jax sweep", SHARD)
        recorded_human.save_to_results(folder.path, DANGEROUS if human else None)
        _save_run(folder, config | human, rng)
        folder.write_partial(RunKey("srl", 1), random_columns(EPISODE_COLUMNS, EPISODES, rng))
    _as_of_format_1(root / "old")
    (root / "sweep" / alarm_figures.DATA).write_text(_alarms())
    for name, text in (_warnings() | {assistance_figure.DATA: _assistance()}).items():
        (root / "sweep" / name).write_text(text)
    (root / "sweep" / boundary_map.DATA).write_text(
        "angle,velocity,steps,boundary\n0.1,0.2,3,0.7\n"
    )
    _make_saves(root / "saves", rng)
    _make_journal(root / "session.jsonl")
    lines = [json.loads(line) for line in (root / "session.jsonl").read_text().splitlines()]
    lines[0]["journal"] = 2
    for line in lines:
        del line["sum"]
    (root / "session-2.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    (root / "ablation").mkdir()
    measures = ["" if name == "alarm_precision" else 1 for name in _COLUMNS[5:]]
    rows = [["default", "hitl-ac", seed, "0123456789ab", "abc1234", *measures] for seed in (0, 1)]
    (root / "ablation" / "runs.csv").write_text(
        "".join(",".join(map(str, row)) + "\n" for row in (_COLUMNS, *rows))
    )
    (root / "tuning").mkdir()
    stage = {"ticks": 2, "seconds": 1.0, "srl": [1.0], "hitl-fix": [1.0], "hitl-ac": [1.0]}
    asked = {
        "budget": TuningOptions().budget,
        "agent": config["agent"],
        "loop": config["loop"],
        "hyper": config["hyper"],
    }
    tests = {method: [1.0, 2.0] for method in ("srl", "hitl-fix", "hitl-ac")}
    done = {"asked": asked, "commit": "abc", "stages": [stage], "tests": tests}
    (root / "tuning" / "mine.json").write_text(json.dumps(done))


def config_of_a_sweep() -> dict[str, Any]:
    options = SweepOptions(
        agent=AGENT, episodes=EPISODES, test_episodes=TESTS, backend="lean", preset="quick"
    )
    return config_of(options)


def human_of(name: str) -> dict[str, str]:
    return recorded_human.digest(DANGEROUS) if name == "recorded" else {}


def random_columns(names: tuple[str, ...], count: int, rng: np.random.Generator) -> dict[str, Any]:
    columns: dict[str, Any] = {name: rng.integers(0, 2, count) for name in names}
    columns |= {name: rng.normal(0.0, 50.0, count) for name in ("return", "shaped_return")}
    columns |= {name: rng.random(count) for name in ("mean_boundary", "final_boundary")}
    columns |= {"episode": np.arange(1, count + 1), "length": np.full(count, LENGTH)}
    columns |= {"trained": np.full(count, 2), "lead_steps": np.full(count, np.nan)}
    columns |= {"end": ["fall"] * count, "mode": ["autonomous"] * count}
    columns["env_steps"] = LENGTH * columns["episode"]
    return {name: columns[name] for name in names}


@functools.cache
def small_team() -> agents.Agent:
    return make_agent(AGENT)


@functools.cache
def params_of_a_team() -> dict[str, np.ndarray]:
    return checkpoint.flatten(compiled.init(small_team(), jax.random.key(0)), np.float32(0.7))


def _save_run(folder: ResultsFolder, config: dict[str, Any], rng: np.random.Generator) -> None:
    info = {"config": config, "versions": {"jax": "1"}, "commit": "abc", "wall_seconds": 1.0}
    info |= {"env_steps": 15, "updates": 7, "diverged": None, "lost_tests": 0, "machine": "a, 2"}
    steps = np.zeros((LENGTH, AGENT.action_size + len(STEP_COLUMNS)), np.float32)
    folder.save_run(
        KEY,
        random_columns(EPISODE_COLUMNS, EPISODES, rng),
        random_columns(TEST_COLUMNS, TESTS, rng),
        params_of_a_team(),
        info,
        random_columns(PROGRESS_COLUMNS, TESTS, rng),
        {"best": Recording(2, steps), "first-intervention": Recording(1, steps)},
        SAMPLES,
    )


def _as_of_format_1(path: pathlib.Path) -> None:
    (path / RUN / DIAGNOSTICS).unlink()  # It came later.
    for file in (path / "config.json", path / RUN / "run.json"):
        document = json.loads(file.read_text()) | {"format": 1}
        without = {k: v for k, v in document.items() if k not in ("digest", "files")}
        file.write_text(json.dumps(without))


def _alarms() -> str:
    lines = [",".join(alarm_figures.COLUMNS)]
    for method in ("srl", "hitl-ac"):
        lines += [f"{method},{seed},{tau},9,4,2,1,1,3" for seed in (0, 1) for tau in (0.0, 0.5)]
    return "\n".join(lines) + "\n"


def _warnings() -> dict[str, str]:
    """The tables of Figure 11."""
    first = {
        warning_figures.WARNINGS: (warning_figures.WARNING_COLUMNS, ["hull_angle", 0.01]),
        warning_figures.PRECISION: (warning_figures.PRECISION_COLUMNS, ["hull_angle", 0.5]),
        warning_figures.RELIABILITY: (warning_figures.RELIABILITY_COLUMNS, [3]),
    }
    return {
        name: "".join(
            ",".join(map(str, row)) + "\n"
            for row in (
                columns,
                *(["hitl-ac", seed, *by, *range(9)][: len(columns)] for seed in (0, 1)),
            )
        )
        for name, (columns, by) in first.items()
    }


def _assistance() -> str:
    alone = [["hitl-ac", seed, "alone", "nobody", 0, 0, 2, 50.5, 1, 90, 0, 0] for seed in (0, 1)]
    called = [["hitl-ac", seed, "chance", "trusts", 0.1, 1, 2, 60, 0, 99, 9, 3] for seed in (0, 1)]
    return "".join(
        ",".join(map(str, row)) + "\n" for row in (assistance_figure.COLUMNS, *alone, *called)
    )


def _make_saves(path: pathlib.Path, rng: np.random.Generator) -> None:
    saves = Saves(path, CAPACITY)
    for ticks in (4, 8):
        columns = random_columns(EPISODE_COLUMNS, EPISODES, rng)
        table = {name: np.asarray(values).tolist() for name, values in columns.items()}
        rows = [dict(zip(table, row, strict=True)) for row in zip(*table.values(), strict=True)]
        facts = dataclasses.asdict(KEY) | {"ticks": ticks, "env_steps": 3, "updates": 1}
        facts |= {"seconds": 1.0, "begun": True, "diverged": None, "commits": ["abc"]}
        facts |= {"recordings": {"best": [1, LENGTH]}, "versions": {"jax": "1"}, "episodes": rows}
        facts |= {"diagnostics": SAMPLES}
        saves.write(
            [
                SavedRun(
                    facts=facts,
                    train=np.arange(3, dtype=np.uint32),
                    acting=np.arange(4, dtype=np.uint32),
                    behavior=np.ones((3, 2), np.float32),
                    snapshots=np.zeros((0, 2), np.float32),
                    boundaries=np.zeros(0, np.float32),
                    observation=np.zeros(24, np.float32),
                    steps=np.zeros((1, 17), np.float32),
                    recordings=np.zeros((LENGTH, 9), np.float32),
                    frames=rng.random((4, 5)).astype(np.float32),
                )
            ]
        )


def _make_journal(path: pathlib.Path) -> None:
    session, noted = Session(setup_of()), journal.Journal(path)
    noted.begin(LiveOptions().header() | {"made": {"versions": {"jax": "1"}, "commit": None}})
    said: list[dict[str, Any]] = [
        {"type": "danger", "down": True, "frame": 0},
        {"type": "danger", "down": False, "frame": 2},
        {"type": "take", "frame": 3},
        {"type": "hands", "action": [0.1, -0.2, 0.3, 1.0]},
        {"type": "assist", "on": True},
        {"type": "let_go", "frame": 9},
        {"type": "undo"},
        {"type": "pause", "on": True},
        {"type": "speed", "factor": 2.0},
        {"type": "seen", "frame": 12},
        {"type": "no_answer", "frame": 11},
        {"type": "gone", "frame": 12},
        {"type": "safe", "frame": 13},
    ]
    while session.frame.number < 40:
        if session.frame.number % 3 == 0 and said:
            noted.said(session, said.pop(0))
        session.tick()
        noted.played(session)
    noted.close()
