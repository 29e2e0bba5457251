"""The live page as a command: played, killed, taken up again; the person as a recorded human."""

import contextlib
import dataclasses
import json
import os
import re
import signal
import socket
import subprocess
import sys

import compiled
import jax
import numpy as np
import pytest
import small
from websockets.sync.client import connect

from hitl_jax.commands import live, recorded
from hitl_jax.config import AgentConfig
from hitl_jax.console.cli import run_main
from hitl_jax.errors import ResultsError
from hitl_jax.live import journal
from hitl_jax.live.begin import lines_of, setup_of
from hitl_jax.live.options import LiveOptions
from hitl_jax.results.provenance import origin
from hitl_jax.sweep.recorded_human import load
from hitl_jax.team import checkpoint
from hitl_jax.team.agent import make_agent

_OPTIONS = (
    *("--no-open-page", "--port", "0", "--warmup-steps", "64", "--initial-boundary", "0.1"),
    *small.OPTIONS,
)

_RULE = {"boundary_learner": "printed", "boundary_source": "rule"}


class _Page:
    """A session in a process of its own, and a page that controls it."""

    def __init__(self, path, *options):
        command = [sys.executable, "-m", "hitl_jax", "live", "--journal", str(path)]
        self.process = subprocess.Popen(
            [*command, *_OPTIONS, *options], stdout=subprocess.PIPE, text=True, env=os.environ
        )
        self.said = ""
        while not (found := re.search(r"http://(\S+)/\?token=(\S+)", self.said)):
            line = self.process.stdout.readline()
            assert line, self.said
            self.said += line
        host, token = found.groups()
        self._open = contextlib.ExitStack()
        self._socket = self._open.enter_context(
            connect(f"ws://{host}/socket?token={token}", origin=f"http://{host}")
        )

    def say(self, kind, **fields):
        self._socket.send(json.dumps({"type": kind, **fields}))

    def until(self, true):
        """The first frame of which something is true."""
        while True:
            message = json.loads(self._socket.recv(timeout=60))
            if message["type"] == "frame":
                self.say("seen", frame=message["n"])
                if true(message):
                    return message

    def stop(self, number):
        self.process.send_signal(number)
        self.said += self.process.communicate(timeout=60)[0]
        self._open.close()
        return self.process.returncode


@pytest.mark.slow
def test_a_session_survives_a_kill_and_becomes_a_human_for_sweeps(tmp_path, capsys):
    path = tmp_path / "session.jsonl"
    page = _Page(path)
    page.say("speed", factor=None)
    alarmed = page.until(lambda frame: frame["alarm"] and frame["n"] > 100)
    page.say("pause", on=True)
    page.say("danger", down=True, frame=alarmed["n"])
    page.say("danger", down=False, frame=alarmed["n"])
    page.say("pause", on=False)
    page.until(lambda frame: frame["n"] > alarmed["n"] + 200)
    assert page.stop(signal.SIGKILL) == -signal.SIGKILL
    last = journal.read(path)[1][-1]["at"]

    page = _Page(path)
    assert f"played again {last:,} of {last:,} frames" in page.said
    page.until(lambda frame: frame["n"] > last + 20)
    assert page.stop(signal.SIGINT) == 0
    assert f"what was learned: {path}.npz" in page.said
    with np.load(f"{path}.npz") as learned:
        assert learned["boundary"].shape == ()

    assert run_main("recorded", recorded.main, [str(path)]) == 0
    said = capsys.readouterr().out
    assert "| threshold |" in said
    human = said.split("--human ")[-1].strip()
    judgements = load(human)
    assert judgements.sum() >= 1
    assert len(judgements) > last - 10


def _refused(options, capsys):
    assert run_main("live", live.main, [*_OPTIONS, *options]) == 2
    said = capsys.readouterr()
    assert said.err.startswith("error: ")
    assert said.err.count("\n") == 1
    return said.err


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--mode", "dream"], "--mode dream: must be one of train, test, watch"),
        (["--mode", "test"], "--start (none): --mode test needs a run's params.npz"),
        (["--start", "gone.npz"], "--start gone.npz: No such file"),
        (["--start", "pyproject.toml"], "--start pyproject.toml: is no checkpoint"),
        (["--seed", "4294967296"], "--seed 4294967296: must be at least 0 and at most"),
        (["--n-step", "5000"], "--n-step 5000: must be at most 1000, half of --capacity"),
        (["--observation-size", "3"], "--observation-size 3: must be 24"),
        (["--method", "srl"], "--method srl: must be one of hitl-ac, hitl-fix"),
        (["--port", "70000"], "--port 70000: must be at least 0 and at most 65535"),
        (["--answer-seconds", "0"], "--answer-seconds 0.0: must be at least 0.1"),
        (["--boundary-source", "network"], "--boundary-source network: must be one of rule"),
        (["--mode", "watch", "--boundary-source", "pid"], "--boundary-source pid: must be one of"),
        (["--mode", "watch", "--ask"], "--ask True: there is nobody to ask with --mode watch"),
        (["--danger", "predictive"], "--danger: is of the simulated human"),
        (["--human.delay", "3"], "--human.delay: is of the simulated human"),
        (["--human-parts", "delay"], "--human-parts: is of the simulated human"),
        (["--mode", "test", "--start", "a.npz", "--human-actions", "still"], "--human-actions: is"),
        (["--final-noise", "0.1"], "--final-noise 0.1: has no meaning beside --noise-steps 0"),
        (["--release-share", "0.3"], "--release-share: is of the simulated human"),
        (["--extra", "foo", "1"], "--extra foo: no choice has options"),
        (["--mode", "watch", "--human.extra", "foo", "1"], "--human.extra foo: no choice has opti"),
        (
            ["--mode", "watch", "--human-policy", "a.npz", "--human-actions", "still"],
            "--human-actions: has no meaning beside --human-policy, whose actions",
        ),
        (["--human-policy", "gone.npz"], "--human-policy gone.npz: No such file"),
    ],
)
def test_bad_options_are_refused(options, message, tmp_path, capsys):
    path = tmp_path / "journal.jsonl"
    assert message in _refused([*options, "--journal", str(path)], capsys)
    assert not path.exists()


def test_a_port_in_use_and_another_sessions_journal_are_refused(tmp_path, capsys):
    path = tmp_path / "journal.jsonl"
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        said = _refused(["--port", port, "--journal", str(path)], capsys)
        assert f"--port {port}: Address already in use" in said
    noted = journal.Journal(path)
    noted.begin(LiveOptions(seed=3).header())
    assert "another process plays this session" in _refused(["--journal", str(path)], capsys)
    noted.close()
    said = _refused(["--journal", str(path)], capsys)
    assert "seed 3, asked for 0: name another journal" in said
    path.write_text("my thesis\n")
    assert "is no journal of a live session" in _refused(["--journal", str(path)], capsys)
    assert path.read_text() == "my thesis\n"


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("thesis.txt", "is no journal of a live session"),
        (".", "Is a directory"),
        ("gone.jsonl", "No such file or directory"),
        ("watched.jsonl", "mode watch: no person judged in this session"),
        ("own.jsonl", "names code that would be run: indicator my_team:tilt; if you trust it, add"),
    ],
)
def test_what_is_no_persons_journal_is_refused(name, told, tmp_path, capsys):
    (tmp_path / "thesis.txt").write_text("my thesis\n")
    own = AgentConfig(intervention="takeover", indicator="my_team:tilt")
    for file, options in (
        ("watched.jsonl", LiveOptions(mode="watch")),
        ("own.jsonl", LiveOptions(agent=own)),
    ):
        noted = journal.Journal(tmp_path / file)
        noted.begin(options.header())
        noted.close()
    path = tmp_path / name
    assert run_main("recorded", recorded.main, [str(path)]) == 2
    assert capsys.readouterr().err.startswith(f"error: JOURNAL {path}: {told}")


def test_a_journal_of_other_versions_says_so(tmp_path, capsys):
    header = LiveOptions().header()
    made = origin()
    path = tmp_path / "journal.jsonl"
    for name, value in (("jax", "0.4.1"), ("numpy", "1.0"), ("box2d", "2.0")):
        path.unlink(missing_ok=True)
        noted = journal.Journal(path)
        noted.begin(header | {"made": made | {"versions": made["versions"] | {name: value}}})
        noted.close()
        assert lines_of(path, header, print) == []
        now = made["versions"].get(name, "none")
        assert capsys.readouterr().out == f"{path} was begun with {name} {value}, now {now}\n"


def test_a_session_from_before_a_choice_was_one_goes_on_with_its_default(tmp_path):
    header = LiveOptions().header()
    old = header | {"agent": dict(header["agent"])}
    del old["agent"]["matmul_precision"]
    path = tmp_path / "journal.jsonl"
    noted = journal.Journal(path)
    noted.begin(old)
    noted.close()
    assert lines_of(path, header, print) == []
    header["agent"]["matmul_precision"] = "bfloat16"
    with pytest.raises(ResultsError, match="matmul_precision float32, asked for bfloat16"):
        lines_of(path, header, print)


def test_a_walker_of_a_sweeps_default_begins_with_its_task_networks(tmp_path):
    learned = make_agent(small.AGENT)  # Another boundary learner than the page's.
    train = compiled.init(learned, jax.random.key(3))
    path = tmp_path / "params.npz"
    np.savez(path, **checkpoint.flatten(train, np.float32(0.0)))
    agent = dataclasses.replace(small.AGENT, **_RULE)
    setup = setup_of(LiveOptions(mode="test", start=str(path), agent=agent))
    assert setup.start["boundary"] == np.float32(setup.hyper.initial_boundary)
    first = setup.first_train(jax.random.key(0))
    jax.tree.map(np.testing.assert_array_equal, first.learner.actor, train.learner.actor)
    assert first.boundary.target_critic is None


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"boundary": np.float32(0.0)}, "its boundary 0: must be at least 0.05 and at most 1.5"),
        ({"boundary": np.zeros(3)}, "its boundary has other layers than this team's"),
        ({"actor/params/Dense_1/bias": np.full(4, np.nan, "f4")}, "not all its numbers are finite"),
        ({}, "its actor has other layers than this team's"),
    ],
)
def test_what_cannot_be_begun_with_is_refused(changed, message, tmp_path, capsys):
    """Such as a run whose boundary is no number that a rule moves."""
    sizes = (16,) if changed else (8,)
    setup = setup_of(
        LiveOptions(agent=dataclasses.replace(small.AGENT, hidden_sizes=sizes, **_RULE))
    )
    train = setup.first_train(jax.random.key(0))
    arrays = checkpoint.flatten(dataclasses.replace(train, key=None), np.float32(0.3))
    np.savez(tmp_path / "start.npz", **arrays | changed)
    assert message in _refused(["--start", str(tmp_path / "start.npz")], capsys)


def test_watching_takes_a_simulated_human():
    setup = setup_of(LiveOptions(mode="watch", seed=1))
    assert not setup.with_person
    assert setup.agent.human.init() is not None
    assert setup.agent.config == make_agent(setup.agent.config).config
