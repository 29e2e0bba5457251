"""Starts a worker process of a pool, and tells how one ended."""

import dataclasses
import os
import select
import signal
import subprocess
import tempfile
from typing import IO

from hitl_jax.envs.interpreter import child_interpreter

CLOSE_SECONDS = 5.0
"""Time that a worker may take to end [s]."""
_LOG_BYTES = 8192
"""Most bytes of a log that are shown."""

# A walker is one thread; a worker's BLAS must not start more and take the learner's cores.
_WORKER_ENVIRONMENT = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "PYGAME_HIDE_SUPPORT_PROMPT": "1",
    "SDL_VIDEODRIVER": "dummy",
}


@dataclasses.dataclass(frozen=True)
class WorkerProcess:
    """A worker process and the pool's ends of its pipes.

    Attributes:
        index: of the worker, from 0.
        process: a byte on its stdin starts a tick; when stdin closes, the process ends. The pool
            holds the first worker's stdin alone: each worker wakes the next.
        reply: file descriptor on which it answers.
        log: its stdout and stderr; read only if it fails.
        poll: waits for bytes on `reply`.
    """

    index: int
    process: subprocess.Popen[bytes]
    reply: int
    log: IO[bytes]
    poll: select.poll

    def has_answered(self, seconds: float) -> bool:
        """Waits some seconds for an answer; also true when its end of the pipe is closed."""
        return bool(self.poll.poll(1000 * seconds))

    def how_it_ended(self) -> str:
        """How the process ended, in one line."""
        try:
            code = self.process.wait(CLOSE_SECONDS)
        except subprocess.TimeoutExpired:
            return "closed its pipe"
        if code < 0:
            return f"was killed by {signal.Signals(-code).name}"
        return ": ".join([f"exited with {code}", *self.log_end().splitlines()[-1:]])

    def log_end(self) -> str:
        """The last bytes of its log."""
        self.log.seek(max(0, os.fstat(self.log.fileno()).st_size - _LOG_BYTES))
        return self.log.read().decode(errors="replace").strip()


def launch(
    backend: str,
    env_id: str,
    memory: int,
    num_walkers: int,
    index: int,
    num_workers: int,
    following: IO[bytes] | None,
) -> WorkerProcess:
    """Starts a worker's process, and does not wait for it.

    It is a new interpreter: a fork would copy a process with JAX's threads, and `multiprocessing`
    would import the user's main module again. Warnings at its imports do not reach the terminal.

    Args:
        backend: `lean` or `gymnasium`.
        env_id: gymnasium's name of the environment.
        memory: file descriptor of the shared memory.
        num_walkers: N.
        index: of the worker, from 0.
        num_workers: W.
        following: stdin of the next worker, which this one wakes; None for the last.
    """
    log = tempfile.TemporaryFile()  # noqa: SIM115, the pool closes it
    reply, answer = os.pipe()
    wakes = [] if following is None else [following.fileno()]
    numbers = (memory, answer, num_walkers, index, num_workers, *wakes)
    python, environment = child_interpreter()
    command = [*python, "-W", "ignore", "-X", "faulthandler", "-m", "hitl_jax.envs.worker"]
    try:
        process = subprocess.Popen(
            [*command, backend, env_id, *map(str, numbers)],
            bufsize=0,
            stdin=subprocess.PIPE,
            stdout=log,
            stderr=log,
            pass_fds=(memory, answer, *wakes),
            env={**environment, **_WORKER_ENVIRONMENT},
        )
    except BaseException:
        os.close(reply)
        log.close()
        raise
    finally:
        os.close(answer)
    poll = select.poll()
    poll.register(reply, select.POLLIN)
    return WorkerProcess(index, process, reply, log, poll)
