"""Every file that we read: how one is made, how it is read, and how damage to it may look.

A new format is attacked by adding it to `FORMATS`.
"""

import csv
import dataclasses
import functools
import io
import json
import pathlib
import random
import re
from collections.abc import Callable
from typing import Any, NamedTuple

import damages
import jax
import numpy as np
from damages import Damage, kind_of
from live_team import setup_of

from hitl_jax.analysis import alarm_figures, boundary_map
from hitl_jax.config import AgentConfig, Hyper, Method, hyper_for
from hitl_jax.live import journal
from hitl_jax.live.begin import networks_from
from hitl_jax.live.options import LiveOptions
from hitl_jax.live.recorded_person import options_from
from hitl_jax.live.session import Session
from hitl_jax.playback import load_trained
from hitl_jax.results.atomic_files import named_errors
from hitl_jax.results.diagnostic_table import FILE as DIAGNOSTICS
from hitl_jax.results.episode_tables import EPISODE_COLUMNS, PROGRESS_COLUMNS, TEST_COLUMNS
from hitl_jax.results.folder import ResultsFolder
from hitl_jax.results.recorded_episodes import STEP_COLUMNS, Recording
from hitl_jax.results.run_key import RunKey
from hitl_jax.studies.ablations.store import _COLUMNS, Store
from hitl_jax.studies.tuning import table as tuning_table
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
_AGENT = AgentConfig(learner="td3", hidden_sizes=(8,), batch_size=8, boundary_hidden_sizes=(4,))
_EPISODES, _TESTS, _LENGTH = 3, 2, 5
_CAPACITY = 8
_SHARD = {"number": 1, "of": 2, "methods": ["srl"], "first_seed": 0, "seeds": 3}
_DANGEROUS = np.arange(300) % 11 == 0


class Format(NamedTuple):
    """A file that we read.

    Attributes:
        name: for people.
        path: below the folder of `make`.
        read: reads it, and all that is read with it; raises ValueError where that is damaged.
        damages: kinds of damage.
        could_be: of the file as it was and as it is now, whether it is another one that we might
            have written; False where a checksum tells. It is asked only where a damaged file was
            read, and not as what it was.
    """

    name: str
    path: str
    read: Callable[[pathlib.Path], Any]
    damages: tuple[Damage, ...]
    could_be: Callable[[bytes, bytes], bool]


# ------------------------------------------------------------------------------ what is made

SAMPLES = [
    {"updates": 1000, "env_steps": 2000, "episodes": 1, "q": 0.5, "critic_loss": 1.25},
    {"updates": 2000, "env_steps": 4000, "episodes": 2, "q": 0.75, "critic_loss": 1.5},
]


def make(root: pathlib.Path) -> None:
    """Makes a folder in which every format occurs."""
    rng = np.random.default_rng(0)
    recorded_human.write(root / "judged.npz", _DANGEROUS)
    config = _config()
    for name in ("sweep", "old", "recorded"):
        human = _human_of(name)
        folder = ResultsFolder(root / name)
        folder.create_or_resume(config | human, "hitl-jax sweep", _SHARD)
        recorded_human.save_to_results(folder.path, _DANGEROUS if human else None)
        _save_run(folder, config | human, rng)
        folder.write_partial(RunKey("srl", 1), _columns(EPISODE_COLUMNS, _EPISODES, rng))
    _as_of_format_1(root / "old")
    (root / "sweep" / alarm_figures.DATA).write_text(_alarms())
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


def _config() -> dict[str, Any]:
    options = SweepOptions(
        agent=_AGENT, episodes=_EPISODES, test_episodes=_TESTS, backend="lean", preset="quick"
    )
    return config_of(options)


def _human_of(name: str) -> dict[str, str]:
    return recorded_human.digest(_DANGEROUS) if name == "recorded" else {}


def _columns(names: tuple[str, ...], count: int, rng: np.random.Generator) -> dict[str, Any]:
    columns: dict[str, Any] = {name: rng.integers(0, 2, count) for name in names}
    columns |= {name: rng.normal(0.0, 50.0, count) for name in ("return", "shaped_return")}
    columns |= {name: rng.random(count) for name in ("mean_boundary", "final_boundary")}
    columns |= {"episode": np.arange(1, count + 1), "length": np.full(count, _LENGTH)}
    columns |= {"trained": np.full(count, 2), "lead_steps": np.full(count, np.nan)}
    columns |= {"end": ["fall"] * count, "mode": ["autonomous"] * count}
    columns["env_steps"] = _LENGTH * columns["episode"]
    return {name: columns[name] for name in names}


@functools.cache
def _team() -> agents.Agent:
    return make_agent(_AGENT)


@functools.cache
def _params() -> dict[str, np.ndarray]:
    return checkpoint.flatten(agents.init(_team(), jax.random.key(0)), np.float32(0.7))


def _save_run(folder: ResultsFolder, config: dict[str, Any], rng: np.random.Generator) -> None:
    info = {"config": config, "versions": {"jax": "1"}, "commit": "abc", "wall_seconds": 1.0}
    info |= {"env_steps": 15, "updates": 7, "diverged": None, "lost_tests": 0, "machine": "a, 2"}
    steps = np.zeros((_LENGTH, _AGENT.action_size + len(STEP_COLUMNS)), np.float32)
    folder.save_run(
        KEY,
        _columns(EPISODE_COLUMNS, _EPISODES, rng),
        _columns(TEST_COLUMNS, _TESTS, rng),
        _params(),
        info,
        _columns(PROGRESS_COLUMNS, _TESTS, rng),
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


def _make_saves(path: pathlib.Path, rng: np.random.Generator) -> None:
    saves = Saves(path, _CAPACITY)
    for ticks in (4, 8):
        columns = _columns(EPISODE_COLUMNS, _EPISODES, rng)
        table = {name: np.asarray(values).tolist() for name, values in columns.items()}
        rows = [dict(zip(table, row, strict=True)) for row in zip(*table.values(), strict=True)]
        facts = dataclasses.asdict(KEY) | {"ticks": ticks, "env_steps": 3, "updates": 1}
        facts |= {"seconds": 1.0, "begun": True, "diverged": None, "commits": ["abc"]}
        facts |= {"recordings": {"best": [1, _LENGTH]}, "versions": {"jax": "1"}, "episodes": rows}
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
                    recordings=np.zeros((_LENGTH, 9), np.float32),
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


# --------------------------------------------------------------------------------- how it is read


def _read_sweep(root: pathlib.Path, name: str = "sweep") -> Any:
    folder = ResultsFolder(root / name)
    document = folder.load_document()
    folder.create_or_resume(_config() | _human_of(name), "again", _SHARD)
    run = folder.load_run(KEY)
    agent = load_trained.agent_of(folder)
    spec, end = load_trained.load_trained(agent, folder, KEY)
    recordings = folder.load_recordings(KEY)
    dangerous = recorded_human.load_kept(folder)
    folder.check_run(KEY)
    return document, vars(run), spec, end, recordings, dangerous


def _read_old(root: pathlib.Path) -> Any:
    return _read_sweep(root, "old")


def _read_recorded(root: pathlib.Path) -> Any:
    return _read_sweep(root, "recorded")


def _read_partials(root: pathlib.Path) -> Any:
    return ResultsFolder(root / "sweep").load_partials()


def _read_judged(root: pathlib.Path) -> Any:
    return recorded_human.load(recorded_human.PREFIX + str(root / "judged.npz"))


def _read_policy(root: pathlib.Path) -> Any:
    return checkpoint.load_actor(root / "old" / RUN / "params.npz", 24, 4)


def _read_start(root: pathlib.Path) -> Any:
    hyper = hyper_for(Method.HITL_AC, Hyper())
    return networks_from(str(root / "old" / RUN / "params.npz"), _team(), hyper)


def _read_saves(root: pathlib.Path) -> Any:
    """The newest save, which must not have given way to the one before."""
    runs, notes = Saves(root / "saves", _CAPACITY).load()
    if notes:
        raise ValueError(notes[0])
    return runs


def _read_journal(root: pathlib.Path, name: str = "session.jsonl") -> Any:
    path = root / name
    header, lines = journal.read(path)
    options_from(path, header, None, None)
    session = Session(setup_of())
    for _ in journal.play(session, lines, path):
        pass
    return header, lines, session.digest()


def _read_old_journal(root: pathlib.Path) -> Any:
    return _read_journal(root, "session-2.jsonl")


def _read_alarms(root: pathlib.Path) -> Any:
    path = root / "sweep" / alarm_figures.DATA
    with named_errors(path):
        return alarm_figures.load_counts(path.read_bytes().decode())


def _read_map(root: pathlib.Path) -> Any:
    return boundary_map.told(ResultsFolder(root / "sweep"))


def _read_store(root: pathlib.Path) -> Any:
    return Store(root / "ablation" / "runs.csv")._rows


def _read_tuning(root: pathlib.Path) -> Any:
    found = tuning_table.load(root / "tuning" / "mine.json")
    tuning_table.table(root / "tuning", TuningOptions())
    if found is None:
        raise ValueError("not written by this command")
    return found


# --------------------------------------------------------------- what we might have written as well

_OPTIONAL = {"shard", "machine", "diverged", "lost_tests", "status", "command", "made", "time"}
_OPTIONAL |= {"matmul_precision", "human_parts", "human_actions", "extra"}  # These came later.
_OPTIONAL |= {"label", "versions", "commit", "processor"}
_NUMBER = re.compile(r"(-?\d+(\.\d+)?(e[+-]?\d+)?|nan)?", re.ASCII)


def never(before: bytes, now: bytes) -> bool:
    """Of what has a checksum."""
    return False


def like_json(before: bytes, now: bytes) -> bool:
    """Whether two documents have the same kinds of values in the same places."""

    def refuse(constant: str) -> None:
        raise ValueError(constant)

    return _alike(json.loads(before), json.loads(now, parse_constant=refuse))


def _alike(before: Any, now: Any) -> bool:
    if isinstance(before, dict) and isinstance(now, dict):
        same = all(
            _alike(before[name], now[name])
            or name == "versions"
            or (name == "commit" and now[name] is None)
            for name in before
            if name in now
        )
        return same and set(before) - set(now) <= _OPTIONAL
    if isinstance(before, list) and isinstance(now, list):
        kinds = {kind_of(one) for one in before}
        return {kind_of(one) for one in now} <= kinds
    if isinstance(now, str) and not now.isprintable():
        return False
    return kind_of(before) == kind_of(now)


def like_signed_json(before: bytes, now: bytes) -> bool:
    """Likewise, of a document whose digest is right: somebody has written it on purpose."""
    return "digest" in json.loads(now) and like_json(before, now)


def like_lines(before: bytes, now: bytes) -> bool:
    """Whether each line is like one that was there, and the chunks follow each other."""
    kinds: dict[str, Any] = {}
    for line in before.splitlines():
        kinds.setdefault(_kind_of_line(json.loads(line)), line)
    for line in now.split(b"\n")[:-1]:
        kind = _kind_of_line(json.loads(line))
        if kind not in kinds or not like_json(kinds[kind], line):
            return False
    return True


def _kind_of_line(line: dict[str, Any]) -> str:
    return str(line["said"].get("type")) if "said" in line else str(sorted(line))


def like_csv(before: bytes, now: bytes) -> bool:
    """Whether a file has the same columns, and numbers where there were numbers."""
    (head, *rows), (head_now, *rows_now) = (
        list(csv.reader(io.StringIO(data.decode()))) for data in (before, now)
    )
    numeric = [all(_NUMBER.fullmatch(row[place]) for row in rows) for place in range(len(head))]
    return (
        head == head_now
        and now.endswith(b"\n")
        and all(len(row) == len(head) for row in rows_now)
        and all(
            _NUMBER.fullmatch(cell) if number else cell.isprintable()
            for row in rows_now
            for number, cell in zip(numeric, row, strict=True)
        )
    )


def like_arrays(before: bytes, now: bytes) -> bool:
    """Whether the arrays have the same names, shapes and types, and are finite."""
    with np.load(io.BytesIO(before)) as old, np.load(io.BytesIO(now)) as new:
        # A run may have recorded nothing.
        return not new.files or (
            old.files == new.files
            and all(
                (old[name].shape, old[name].dtype) == (new[name].shape, new[name].dtype)
                and np.isfinite(new[name]).all()
                for name in old.files
            )
        )


def like_judgements(before: bytes, now: bytes) -> bool:
    """Whether it is one row of yes and no."""
    with np.load(io.BytesIO(now)) as new:
        return new.files == ["dangerous"] and str(new["dangerous"].dtype) == "bool"


def like_an_actor(before: bytes, now: bytes) -> bool:
    """Whether the arrays of the actor are as they were, whatever else there is."""
    with np.load(io.BytesIO(before)) as old, np.load(io.BytesIO(now)) as new:
        own = [name for name in old.files if name.startswith("actor/")]
        return all(
            name in new.files
            and new[name].dtype == np.float32
            and (len(own) > 4 or new[name].shape == old[name].shape)
            for name in own
        )


# ---------------------------------------------------------------------------- damage to a journal


def _in_a_line(damage: Damage) -> Damage:
    """Damage to one line of a journal; its checksum stays."""

    def damaged(data: bytes, chance: random.Random) -> bytes:
        lines = data.splitlines()
        place = chance.randrange(len(lines))
        lines[place] = damage(lines[place], chance).rstrip(b"\n")
        return b"\n".join(lines) + b"\n"

    damaged.__name__ = f"{damage.__name__}_in_a_line"
    return damaged


def sign_lines(data: bytes, chance: random.Random) -> bytes:
    """Damage to one line, with all checksums right, as an attacker would have them."""
    lines = _in_a_line(damages.swap_types)(data, chance).splitlines()
    signed, before = [], b""
    for line in lines:
        document = json.loads(line)
        if isinstance(document, dict):
            document.pop("sum", None)
        text = json.dumps(document, separators=(",", ":")).encode()
        before = journal.next_sum(before, text)
        signed.append(text[:-1] + b',"sum":"' + before + b'"}')
    return b"\n".join(signed) + b"\n"


def sign_save(data: bytes, chance: random.Random) -> bytes:
    """Damage to the arrays or the head of a save, with its checksum right."""
    size = 16
    with np.load(io.BytesIO(data[:-size])) as archive:
        arrays = {name: archive[name] for name in archive.files}
    if "head" in arrays and chance.random() < 0.6:
        head = damages.swap_types(arrays["head"].tobytes(), chance)
        arrays["head"] = np.frombuffer(head, np.uint8)
        file = io.BytesIO()
        np.savez(file, allow_pickle=False, **arrays)
        changed = file.getvalue()
    else:
        changed = damages.swap_arrays(data[:-size], chance)
    from hitl_jax.training.saved_run_store import digest

    return changed + digest(changed)


def like_a_save(before: bytes, now: bytes) -> bool:
    """Whether a save that somebody signed has the arrays and the head of one."""
    with np.load(io.BytesIO(before[:-16])) as old, np.load(io.BytesIO(now[:-16])) as new:
        if not set(old.files) <= set(new.files):
            return False
        same = all(
            old[name].dtype.kind == new[name].dtype.kind
            for name in old.files
            if not name.endswith("boundaries")
        )
        if "head" not in old.files:
            return same
        return same and like_json(old["head"].tobytes(), new["head"].tobytes())


_BYTES = damages.OF_BYTES
_JSON = _BYTES + damages.OF_JSON
_CSV = _BYTES + damages.OF_CSV
_ARRAYS = _BYTES + damages.OF_ARRAYS
_LINES = (
    *_BYTES,
    damages.swap_lines,
    damages.repeat_a_line,
    _in_a_line(damages.swap_types),
    _in_a_line(damages.not_numbers),
)

FORMATS = (
    Format("config.json", "sweep/config.json", _read_sweep, _JSON, like_signed_json),
    Format("run.json", f"sweep/{RUN}/run.json", _read_sweep, _JSON, like_signed_json),
    Format("episodes.csv", f"sweep/{RUN}/episodes.csv", _read_sweep, _CSV, never),
    Format("test.csv", f"sweep/{RUN}/test.csv", _read_sweep, _CSV, never),
    Format("progress.csv", f"sweep/{RUN}/progress.csv", _read_sweep, _CSV, never),
    Format(DIAGNOSTICS, f"sweep/{RUN}/{DIAGNOSTICS}", _read_sweep, _CSV, never),
    Format("params.npz", f"sweep/{RUN}/params.npz", _read_sweep, _ARRAYS, never),
    Format("episodes.npz", f"sweep/{RUN}/episodes.npz", _read_sweep, _ARRAYS, never),
    Format("config.json, format 1", "old/config.json", _read_old, _JSON, like_json),
    Format("run.json, format 1", f"old/{RUN}/run.json", _read_old, _JSON, like_json),
    Format("episodes.csv, format 1", f"old/{RUN}/episodes.csv", _read_old, _CSV, like_csv),
    Format("test.csv, format 1", f"old/{RUN}/test.csv", _read_old, _CSV, like_csv),
    Format("progress.csv, format 1", f"old/{RUN}/progress.csv", _read_old, _CSV, like_csv),
    Format("params.npz, format 1", f"old/{RUN}/params.npz", _read_old, _ARRAYS, like_arrays),
    Format("episodes.npz, format 1", f"old/{RUN}/episodes.npz", _read_old, _ARRAYS, like_arrays),
    Format("partial episodes", "sweep/partial/srl-seed-0001.csv", _read_partials, _CSV, like_csv),
    Format("human.npz", "recorded/human.npz", _read_recorded, _ARRAYS, never),
    Format("--human", "judged.npz", _read_judged, _ARRAYS, like_judgements),
    Format("--human-policy", f"old/{RUN}/params.npz", _read_policy, _ARRAYS, like_an_actor),
    Format("--start", f"old/{RUN}/params.npz", _read_start, _ARRAYS, like_arrays),
    Format(
        "save: state", "saves/state-000002.npz", _read_saves, (*_ARRAYS, sign_save), like_a_save
    ),
    Format(
        "save: frames", "saves/frames-000002.npz", _read_saves, (*_BYTES, sign_save), like_a_save
    ),
    Format("journal", "session.jsonl", _read_journal, (*_LINES, sign_lines), like_lines),
    Format("journal, version 2", "session-2.jsonl", _read_old_journal, _LINES, like_lines),
    Format("alarms.csv", "sweep/alarms.csv", _read_alarms, _CSV, like_csv),
    Format("boundary_map.csv", "sweep/boundary_map.csv", _read_map, _CSV, like_csv),
    Format("ablation's runs.csv", "ablation/runs.csv", _read_store, _CSV, like_csv),
    Format("tuning's json", "tuning/mine.json", _read_tuning, _JSON, like_json),
)
