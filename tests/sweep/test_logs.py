"""What other tools read of a sweep's logs is what its tables have."""

import json
import os
import struct

import numpy as np
import pandas
import pytest
import small

from hitl_jax.commands.seed_sweep import main
from hitl_jax.config import Hyper, Method, hyper_for
from hitl_jax.console.cli import run_main
from hitl_jax.errors import InvalidValue
from hitl_jax.results.episode_measures import fall_at_once
from hitl_jax.results.run_key import RunKey
from hitl_jax.sweep import run_sweep
from hitl_jax.sweep.logs import LOGS, SweepLogs
from hitl_jax.sweep.logs.run_log import require_log
from hitl_jax.sweep.options import SweepOptions
from hitl_jax.training.run_spec import Divergence, Run, RunSpec

_SMALL = [
    *("--seeds", "1", "--methods", "hitl-ac", "--episodes", "2", "--test-episodes", "1"),
    *("--warmup-steps", "100", "--workers", "2", *small.OPTIONS),
]
_COLUMNS = {
    "1_human/interventions": "interventions",
    "2_return/training": "return",
    "3_alarms/count": "alarms",
    "4_boundary/mean": "mean_boundary",
}


class Kept:
    """A log of one's own: `--log test_logs:Kept`."""

    written: dict = {}  # noqa: RUF012

    def __init__(self, run):
        self.rows = self.written.setdefault(run.key, [])

    def write(self, values, step):
        self.rows.append((step, dict(values)))

    def close(self):
        self.rows.append("closed")


class Broken(Kept):
    def write(self, values, step):
        raise OSError("the disk is full")


@pytest.fixture(scope="module")
def logged(tmp_path_factory):
    """A sweep with all logs that can be written here."""
    pytest.importorskip("tensorboardX")
    names = [name for name in LOGS if _is_here(name)]
    out = tmp_path_factory.mktemp("logged")
    Kept.written.clear()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run_sweep, "draw", lambda _: [])
        patch.setenv("WANDB_MODE", "offline")
        words = [*_SMALL, "--log", *names, "test_logs:Kept", "test_logs:Broken"]
        assert run_main("sweep", main, [*words, "--out", str(out)]) == 0
    return out


def _is_here(name):
    try:
        require_log(name)
    except ImportError:
        return False
    return True


def _tables(out):
    run = out / "runs" / "hitl-ac" / "seed-0000"
    return [pandas.read_csv(run / f"{name}.csv") for name in ("episodes", "diagnostics", "test")]


def _require_equal(series, out, exact=True):
    """`series`: (steps, values) by name."""
    episodes, diagnostics, tests = _tables(out)
    rtol = 1e-12 if exact else 1e-6  # Older releases of pandas may lose the last bits of a number.
    for name, column in _COLUMNS.items():
        steps, values = series[name]
        np.testing.assert_array_equal(steps, episodes["env_steps"])
        np.testing.assert_allclose(values, episodes[column], rtol=rtol)
    rate = episodes["human_steps"] / episodes["length"]
    np.testing.assert_allclose(series["1_human/intervention_rate"][1], rate, rtol=rtol)
    for column in set(diagnostics) - {"updates", "env_steps", "episodes"}:
        known = diagnostics[column].notna()
        steps, values = series.get(f"5_learner/{column}", ([], []))
        np.testing.assert_array_equal(steps, diagnostics["env_steps"][known])
        np.testing.assert_allclose(values, diagnostics[column][known], rtol=rtol)
    for mode in ("autonomous", "assisted"):
        [value] = series[f"2_return/{mode}_test_at_the_end"][1]
        np.testing.assert_allclose(value, tests[tests["mode"] == mode]["return"].mean(), rtol=1e-6)


def test_event_files_have_what_the_tables_have(logged):
    from tensorboardX.proto.event_pb2 import Event

    [file] = (logged / "tensorboard" / "hitl-ac" / "seed-0000").iterdir()
    data, place, series = file.read_bytes(), 0, {}
    while place < len(data):  # A record: its length, a checksum, the event, a checksum.
        (length,) = struct.unpack_from("<Q", data, place)
        event = Event.FromString(data[place + 12 : place + 12 + length])
        for value in event.summary.value:
            steps, values = series.setdefault(value.tag, ([], []))
            steps.append(event.step)
            values.append(value.simple_value)
        place += 16 + length
    _require_equal(series, logged, exact=False)  # They hold float32.


def _records(data):
    """Of a log as LevelDB writes it: blocks of 32 KiB, of parts that begin with a head."""
    place, whole = 7, b""  # Behind the file's own head.
    while place + 7 <= len(data):
        if (left := -place % 2**15) < 7 and left:
            place += left  # No head fits there.
            continue
        length, kind = struct.unpack_from("<HB", data, place + 4)
        whole += data[place + 7 : place + 7 + length]
        place += 7 + length
        if kind in (1, 4):  # All of a record, or its last part.
            yield whole
            whole = b""


def test_weights_and_biases_has_what_the_tables_have(logged):
    pytest.importorskip("wandb")
    from wandb.proto.wandb_internal_pb2 import Record

    [file] = (logged / "wandb").glob("offline-run-*/*.wandb")
    series = {}
    for data in _records(file.read_bytes()):
        row = {}
        for item in Record.FromString(data).history.item:
            row[item.key or "/".join(item.nested_key)] = json.loads(item.value_json)
        for name, value in row.items():
            steps, values = series.setdefault(name, ([], []))
            steps.append(row.get("env_steps"))
            values.append(value)
    _require_equal(series, logged)


def test_a_log_of_ones_own_has_what_the_tables_have(logged):
    rows = Kept.written[RunKey("hitl-ac", 0)]
    *written, last = [row for row in rows if row != "closed"] + [rows[-1]]
    assert last == "closed"
    series = {}
    for step, values in written:
        for name, value in values.items():
            steps, all_values = series.setdefault(name, ([], []))
            steps.append(step)
            all_values.append(value)
    _require_equal(series, logged)


def _run(method, episodes, diverged=None):
    spec = RunSpec(Method(method), 1, hyper_for(Method(method), Hyper()), episodes=5)
    rows = [{"episode": n + 1, "env_steps": 10 * (n + 1)} | fall_at_once() for n in range(episodes)]
    return Run(spec, 0, episodes=rows, env_steps=10 * episodes, diverged=diverged)


def test_a_log_that_fails_is_given_up_and_no_other(tmp_path):
    said = []
    Kept.written = {}
    logs = SweepLogs(["test_logs:Broken", "test_logs:Kept"], tmp_path, {}, said.append)
    logs.follow([_run("srl", 1)])
    logs.follow([_run("srl", 2)])
    logs.close()
    assert said == ["log test_logs:Broken: OSError: the disk is full; no more is logged there"]
    assert _steps("srl") == [10, 20]


def _steps(method):
    return [row[0] for row in Kept.written[RunKey(method, 1)] if row != "closed"]


def test_a_run_that_another_machine_begins_anew_is_logged_anew(tmp_path):
    Kept.written = {}
    logs = SweepLogs(["test_logs:Kept"], tmp_path, {}, pytest.fail)
    for count in (2, 3, 0, 1, 4):
        logs.follow([_run("srl", count)])
    rows = Kept.written[RunKey("srl", 1)]
    assert _steps("srl") == [10, 20, 30, 10, 20, 30, 40]
    assert rows[3] == "closed"


def test_a_run_that_diverged_is_logged_with_its_tests(tmp_path):
    Kept.written = {}
    logs = SweepLogs(["test_logs:Kept"], tmp_path, {}, pytest.fail)
    tests = [{"mode": "autonomous"} | fall_at_once()]
    run = _run("hitl-ac", 2, Divergence("action", 20, 2))
    logs.finish(run, tests, [{"trained": 4} | tests[0]])
    written = [row for row in Kept.written[RunKey("hitl-ac", 1)] if row != "closed"]
    assert written[-2:] == [
        (22, {"2_return/autonomous_test": -100.0}),
        (23, {"2_return/autonomous_test_at_the_end": -100.0}),
    ]


def test_no_log_is_opened_where_none_is_asked_for(tmp_path):
    logs = SweepLogs([], tmp_path, {}, pytest.fail)
    logs.follow([None])
    logs.close()
    assert not os.listdir(tmp_path)


def test_what_cannot_be_logged_is_said_before_any_work(monkeypatch):
    with pytest.raises(InvalidValue, match=r"^log tensorbord: must be one of tensorboard, wandb"):
        SweepOptions(log=("tensorbord",)).checked()
    for names, said in (
        (("none_such:log",), "log none_such:log: none_such cannot be imported"),
        (("tensorboard", "tensorboard"), "log tensorboard tensorboard: each at most once"),
    ):
        with pytest.raises(InvalidValue, match=f"^{said}"):
            SweepOptions(log=names).checked()
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(ImportError, match=r'^log wandb: pip install -e "\.\[log\]"$'):
        SweepOptions(log=("wandb",)).checked()
