"""A page on this machine on which a person is the human: `hitl-jax live`."""

import asyncio
import contextlib
import dataclasses
import os
import pathlib
import secrets
import signal
import socket
import sys
import webbrowser
from collections.abc import Iterator
from typing import Annotated, Any

import tyro

from hitl_jax.choices.checks import one_of, require
from hitl_jax.config import (
    AgentConfig,
    Hyper,
    Method,
    RunHyper,
    hyper_for,
    validate_hyper,
)
from hitl_jax.console.cli import checking_input
from hitl_jax.envs import box2d
from hitl_jax.errors import BadInput, ResultsError
from hitl_jax.evaluation.trials import frozen
from hitl_jax.human import actions
from hitl_jax.learner.networks import Actor
from hitl_jax.live import journal, person
from hitl_jax.live.pacing import Conductor, Manners
from hitl_jax.live.session import Session
from hitl_jax.live.setup import Setup
from hitl_jax.results.atomic_files import write_bytes_atomic
from hitl_jax.results.config_diff import changes, completed
from hitl_jax.results.npz_archives import to_npz
from hitl_jax.results.provenance import origin
from hitl_jax.sweep.compile_cache import keep_programs
from hitl_jax.sweep.options import require_room, require_team
from hitl_jax.sweep.signals import Interrupted, deferred_interrupts
from hitl_jax.sweep.train_and_test import policy_digest
from hitl_jax.team import checkpoint
from hitl_jax.team.agent import Agent, make_agent
from hitl_jax.training.run_spec import LoopConfig

MODES = ("train", "test", "watch")
_HOST = "127.0.0.1"
_SIMULATED = ("human", "takeover_steps")


@dataclasses.dataclass(frozen=True)
class LiveOptions:
    """Watch a walker learn, and be its human, on a page in the browser.

    Attributes:
        mode: `train`, you are the human; `watch`, a simulated human is; `test`, a trained walker
            asks you for help where it crosses its boundary.
        start: a run's `params.npz` to begin with (default: from scratch; `test` needs one).
        method: `hitl-ac`, whose boundary is learned, or `hitl-fix`.
        seed: of the run.
        ask: whether the walker also stops and asks while it trains.
        answer_seconds: how long it waits for an answer [s]; then it goes on as if it were "safe".
        human_policy: a `params.npz` whose actor is the assistant, and the simulated human's hands
            (default: gymnasium's scripted walker).
        port: of the page, on this machine; 0 takes any.
        open_page: whether to open the page in a browser.
        journal: where everything is noted. The same command goes on where it was; what was learned
            is beside it, with the ending .npz.
        agent: static choices.
        loop: how much the run learns.
        hyper: numbers.
    """

    mode: str = "train"
    start: str | None = None
    method: str = "hitl-ac"
    seed: int = 0
    ask: bool = False
    answer_seconds: float = 5.0
    human_policy: str | None = None
    port: int = 8765
    open_page: bool = True
    journal: str = "runs/live/session.jsonl"
    agent: Annotated[AgentConfig, tyro.conf.arg(name="")] = AgentConfig(intervention="takeover")
    loop: Annotated[LoopConfig, tyro.conf.arg(name="")] = LoopConfig()
    hyper: Annotated[Hyper, tyro.conf.arg(name="")] = Hyper()

    def checked(self) -> "LiveOptions":
        """Checks everything that can be checked before work starts; returns itself.

        Raises:
            ValueError: one line with the option, the value and what is allowed.
        """
        one_of("mode", self.mode, MODES)
        one_of("method", self.method, (str(Method.HITL_AC), str(Method.HITL_FIX)))
        require("seed", self.seed, at_least=0, at_most=2**32 - 1)
        require("answer_seconds", self.answer_seconds, at_least=0.1)
        require("port", self.port, at_least=0, at_most=65535)
        validate_hyper(self.hyper)
        require_team(self.agent, self.loop)
        require_room(self.agent, self.loop, slots=1)
        if self.mode == "test" and self.start is None:
            raise ValueError("--start (none): --mode test needs a run's params.npz")
        # The others find a boundary as they act: there is none to show of the state that comes
        # next, nor one that a label could move afterwards.
        one_of("boundary_source", self.agent.boundary_source, ("rule",))
        if self.with_person:
            one_of("feedback_schedule", self.agent.feedback_schedule, ("step",))
            self._require_nothing_simulated()
        elif self.ask:
            raise ValueError("--ask True: there is nobody to ask with --mode watch")
        return self

    def _require_nothing_simulated(self) -> None:
        """Refuses options of the simulated human, whom nobody would ask."""
        for part, names in ((self.agent, ("danger", "release")), (self.hyper, _SIMULATED)):
            for name in names:
                if getattr(part, name) != getattr(type(part)(), name):
                    raise ValueError(
                        f"--{name.replace('_', '-')}: is of the simulated human; where you are the "
                        "human (--mode train, test) it has no meaning"
                    )

    @property
    def with_person(self) -> bool:
        """Whether a person is the human."""
        return self.mode != "watch"

    def header(self) -> dict[str, Any]:
        """What defines the session's numbers; a journal begins with it."""
        return {
            "mode": self.mode,
            "method": self.method,
            "seed": self.seed,
            "start": policy_digest(self.start, name="start"),
            "human_policy": policy_digest(self.human_policy),
            "agent": dataclasses.asdict(self.agent),
            "loop": dataclasses.asdict(self.loop),
            "hyper": dataclasses.asdict(self.hyper),
        }


def setup_of(options: LiveOptions) -> Setup:
    """What a session begins with.

    Raises:
        ValueError: one line, if a file is not what it should be.
    """
    config = options.agent
    assistant = None
    if options.human_policy is not None:
        actor = checkpoint.load_actor(
            options.human_policy, config.observation_size, config.action_size
        )
        *hidden, size = checkpoint.hidden_sizes(actor)
        assistant = actions.policy(Actor(tuple(hidden), size).apply, actor)
    hyper = hyper_for(Method(options.method), options.hyper)
    if options.mode == "test":
        hyper = frozen(hyper, human_present=True)
    if options.with_person:
        hands = person.hands(config.action_size, assistant)
        agent = make_agent(config, judge=person.judge(), source=hands)
    else:
        agent = make_agent(config, source=assistant)
    return Setup(
        agent=agent,
        hyper=hyper,
        loop=options.loop,
        method=Method(options.method),
        seed=options.seed,
        with_person=options.with_person,
        learns=options.mode != "test",
        start=None if options.start is None else _networks(options.start, agent, hyper),
    )


def main(options: LiveOptions) -> int:
    """Serves the page until Ctrl-C.

    Args:
        options: how.

    Returns:
        The exit code.
    """
    with contextlib.ExitStack() as held:
        with checking_input():
            options = options.checked()
            box2d.require("the live walker")
            header = options.header()
            setup = setup_of(options)
            try:
                import uvicorn  # noqa: F401, a missing extra is noticed before any work
            except ImportError as error:
                raise ImportError('the page needs: pip install -e ".[live]"') from error
            listening = held.enter_context(contextlib.closing(_listen(options.port)))
            path = pathlib.Path(options.journal)
            try:
                noted = held.enter_context(contextlib.closing(journal.Journal(path)))
                lines = [] if noted.is_new else _lines_of(path, header)
            except ResultsError as error:
                raise BadInput(f"--journal {error}") from error
        keep_programs()
        print("compiling ...", flush=True)
        session = Session(setup)
        if noted.is_new:
            noted.begin(header | {"made": origin()})
        _go_on(session, lines, path)
        code = _serve(options, session, noted, listening)
        kept = path.with_name(f"{path.name}.npz")
        write_bytes_atomic(kept, to_npz(checkpoint.flatten(*session.networks())))
        print(f"Played {session.frame.number:,} frames; what was learned: {kept}")
        return code


def _serve(
    options: LiveOptions, session: Session, noted: journal.Journal, listening: socket.socket
) -> int:
    """Serves the page until a signal; the exit code."""
    from hitl_jax.live.server import Live

    port, token = listening.getsockname()[1], secrets.token_urlsafe(16)
    title = f"{options.method.upper()}, seed {options.seed}"
    asks = options.ask or options.mode == "test"
    manners = Manners(options.mode, title, asks, options.answer_seconds)
    page = Live(Conductor(session, noted, manners), token)
    address = f"http://{_HOST}:{port}/?token={token}"
    print(f"The page: {address}\nThe journal: {options.journal}")
    print("Ctrl-C ends; the same command goes on.", flush=True)
    with contextlib.ExitStack() as held:
        if options.open_page and _has_display():
            held.enter_context(opened(address, pathlib.Path(options.journal)))
        interrupted = held.enter_context(deferred_interrupts())
        # Uvicorn gives the signal that ended it on to who had it before.
        asyncio.run(page.serve(page.server(), listening))
        try:
            interrupted()
        except Interrupted as stopped:
            return 0 if stopped.exit_code == 128 + signal.SIGINT else stopped.exit_code
    return 0


@contextlib.contextmanager
def opened(address: str, path: pathlib.Path) -> Iterator[None]:
    """Opens an address in the browser, which others on this machine cannot see.

    They see the command lines of its processes, and this has the token in it. So the browser gets a
    file that only the user can read, and that sends it on. The file is there while the page is.

    Args:
        address: with the token.
        path: of the journal; the file is put beside it.
    """
    door = path.absolute().with_name(path.name + journal.DOOR)
    # Not in a hidden folder, nor in /tmp: a browser in a container may not read there.
    page = f'<!doctype html><meta http-equiv="refresh" content="0; url={address}">\n'
    write_bytes_atomic(door, page.encode(), mode=0o600)
    try:
        webbrowser.open(door.as_uri())
        yield
    finally:
        with contextlib.suppress(OSError):
            door.unlink()


def _lines_of(path: pathlib.Path, header: dict[str, Any]) -> list[journal.Line]:
    """What was noted before, if the session is the same.

    Raises:
        ResultsError: naming the first difference.
    """
    before, lines = journal.read(path)
    before = completed(before)
    tell_differences(path, before)
    told = {name: value for name, value in before.items() if name not in ("journal", "made")}
    asked, has, nothing = _flat(header), _flat(told), object()
    for name in asked | has:
        if asked.get(name, nothing) != has.get(name, nothing):
            raise ResultsError(
                f"{path}: its session has {name[:50]} {str(has.get(name))[:50]}, asked for "
                f"{asked.get(name)}: name another journal"
            )
    return lines


def tell_differences(path: pathlib.Path, header: dict[str, Any]) -> None:
    """Prints one line if a session was begun with other versions, or on another processor."""
    if changed := changes(header.get("made", {}), origin()):
        print(f"{path} was begun with {'; '.join(changed)}", flush=True)


def _go_on(session: Session, lines: list[journal.Line], path: pathlib.Path) -> None:
    """Plays what was noted again, and tells how far it is."""
    last = lines[-1]["at"] if lines else 0
    for frame in journal.play(session, lines, path):
        if frame % 3200 == 0 or frame == last:
            print(f"played again {frame:,} of {last:,} frames", flush=True)


def _flat(tree: Any, name: str = "") -> dict[str, Any]:
    if not isinstance(tree, dict):
        return {name: list(tree) if isinstance(tree, tuple) else tree}
    parts = (_flat(value, f"{name}.{key}" if name else key) for key, value in tree.items())
    return {key: value for part in parts for key, value in part.items()}


def _listen(port: int) -> socket.socket:
    listening = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listening.bind((_HOST, port))
        listening.listen()  # A page that is opened at once waits.
    except OSError as error:
        listening.close()
        raise ValueError(f"--port {port}: {error.strerror}") from error
    return listening


def _networks(path: str, agent: Agent, hyper: RunHyper) -> dict[str, Any]:
    try:
        networks = checkpoint.networks_of(agent, checkpoint.load(path))
        boundary = float(networks["boundary"])
        low, high = float(hyper.boundary_low), float(hyper.boundary_high)
        if not low <= boundary <= high:
            raise ValueError(
                f"its boundary {boundary:g}: must be at least {low:g} and at most {high:g}"
            )
    except ValueError as error:
        raise ValueError(f"--start {path}: {error}") from error
    return networks


def _has_display() -> bool:
    named = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    return bool(named) or sys.platform in ("darwin", "win32")
