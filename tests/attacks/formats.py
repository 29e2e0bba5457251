"""Every file that we read: how one is made, how it is read, and how damage to it may look.

A new format is attacked by adding it to `FORMATS`.
"""

import io
import json
import pathlib
import random
from collections.abc import Callable
from typing import Any, NamedTuple

import damages
import numpy as np
from accepted import (
    like_a_save,
    like_an_actor,
    like_arrays,
    like_csv,
    like_json,
    like_judgements,
    like_lines,
    like_signed_json,
    never,
)
from damages import Damage
from live_team import setup_of
from made_files import CAPACITY, KEY, RUN, SHARD, config_of_a_sweep, human_of, small_team

from hitl_jax.analysis import alarm_figures, assistance_figure, boundary_map, warning_figures
from hitl_jax.config import Hyper, Method, hyper_for
from hitl_jax.live import journal
from hitl_jax.live.begin import networks_from
from hitl_jax.live.recorded_person import options_from
from hitl_jax.live.session import Session
from hitl_jax.playback import load_trained
from hitl_jax.results.atomic_files import named_errors
from hitl_jax.results.diagnostic_table import FILE as DIAGNOSTICS
from hitl_jax.results.folder import ResultsFolder
from hitl_jax.results.npz_archives import from_npz
from hitl_jax.studies.ablations.store import Store
from hitl_jax.studies.tuning import table as tuning_table
from hitl_jax.studies.tuning.options import TuningOptions
from hitl_jax.sweep import fitted_human, recorded_human
from hitl_jax.team import checkpoint
from hitl_jax.training.saved_run_store import Saves


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


# --------------------------------------------------------------------------------- how it is read


def _read_sweep(root: pathlib.Path, name: str = "sweep") -> Any:
    folder = ResultsFolder(root / name)
    document = folder.load_document()
    folder.create_or_resume(config_of_a_sweep() | human_of(name), "again", SHARD)
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


def _read_fitted(root: pathlib.Path) -> Any:
    return from_npz(fitted_human.load(fitted_human.PREFIX + str(root / "fitted.npz")).data)


def _read_policy(root: pathlib.Path) -> Any:
    return checkpoint.load_actor(root / "old" / RUN / "params.npz", 24, 4)


def _read_start(root: pathlib.Path) -> Any:
    hyper = hyper_for(Method.HITL_AC, Hyper())
    return networks_from(str(root / "old" / RUN / "params.npz"), small_team(), hyper)


def _read_saves(root: pathlib.Path) -> Any:
    """The newest save, which must not have given way to the one before."""
    runs, notes = Saves(root / "saves", CAPACITY).load()
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


def _read_warnings(root: pathlib.Path) -> Any:
    return warning_figures.load_all(ResultsFolder(root / "sweep"))


def _read_assistance(root: pathlib.Path) -> Any:
    return assistance_figure.load(root / "sweep" / assistance_figure.DATA)


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
    Format("--human, fitted", "fitted.npz", _read_fitted, _ARRAYS, like_arrays),
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
    *(
        Format(name, f"sweep/{name}", _read_warnings, _CSV, like_csv)
        for name in warning_figures.TABLES
    ),
    Format("assistance.csv", "sweep/assistance.csv", _read_assistance, _CSV, like_csv),
    Format("boundary_map.csv", "sweep/boundary_map.csv", _read_map, _CSV, like_csv),
    Format("ablation's runs.csv", "ablation/runs.csv", _read_store, _CSV, like_csv),
    Format("tuning's json", "tuning/mine.json", _read_tuning, _JSON, like_json),
)
