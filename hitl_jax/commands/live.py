"""A page on this machine on which a person is the human: `hitl-jax live`."""

import asyncio
import contextlib
import pathlib
import secrets
import signal
import socket

from hitl_jax.console.cli import checking_input, refusing
from hitl_jax.console.output import say
from hitl_jax.envs import box2d
from hitl_jax.live import journal
from hitl_jax.live.address import HOST, has_display, listen, opened
from hitl_jax.live.begin import go_on, lines_of, setup_of
from hitl_jax.live.guide import require_same
from hitl_jax.live.options import LiveOptions
from hitl_jax.live.pacing import PacedSession
from hitl_jax.live.page_updates import PageOptions
from hitl_jax.live.session import Session
from hitl_jax.results.atomic_files import write_bytes_atomic
from hitl_jax.results.npz_archives import to_npz
from hitl_jax.results.provenance import origin
from hitl_jax.sweep.compile_cache import keep_programs
from hitl_jax.sweep.signals import Interrupted, deferred_interrupts
from hitl_jax.team import checkpoint


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
            listening = held.enter_context(contextlib.closing(listen(options.port)))
            path = pathlib.Path(options.journal)
            with refusing(results="--journal"):
                noted = held.enter_context(contextlib.closing(journal.Journal(path)))
                lines = [] if noted.is_new else lines_of(path, header, say)
                require_same(path, lines, options.guide)
        keep_programs()
        say("compiling ...")
        session = Session(setup)
        if noted.is_new:
            noted.begin(header | {"made": origin()})
        go_on(session, lines, path, say)
        paced = PacedSession(session, noted, _shown(options), journal.kinds(lines))
        code = _serve(options, paced, listening)
        kept = path.with_name(f"{path.name}.npz")
        write_bytes_atomic(kept, to_npz(checkpoint.flatten(*session.networks())))
        print(f"Played {session.frame.number:,} frames; what was learned: {kept}")
        return code


def _shown(options: LiveOptions) -> PageOptions:
    return PageOptions(
        mode=options.mode,
        title=f"{options.method.upper()}, seed {options.seed}",
        asks=options.asks,
        answer_seconds=options.answer_seconds,
        guide=options.guide,
    )


def _serve(options: LiveOptions, session: PacedSession, listening: socket.socket) -> int:
    """Serves the page until a signal; the exit code."""
    from hitl_jax.live.server import PageServer

    port, token = listening.getsockname()[1], secrets.token_urlsafe(16)
    page = PageServer(session, token, pathlib.Path(options.journal))
    address = f"http://{HOST}:{port}/?token={token}"
    print(f"The page: {address}\nThe journal: {options.journal}")
    say("Ctrl-C ends; the same command goes on.")
    with contextlib.ExitStack() as held:
        if options.open_page and has_display():
            held.enter_context(opened(address, pathlib.Path(options.journal)))
        interrupted = held.enter_context(deferred_interrupts())
        # Uvicorn gives the signal that ended it on to who had it before.
        asyncio.run(page.serve(page.server(), listening))
        try:
            interrupted()
        except Interrupted as stopped:
            return 0 if stopped.exit_code == 128 + signal.SIGINT else stopped.exit_code
    return 0
