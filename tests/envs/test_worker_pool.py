"""Worker processes that are killed, raise, outlive their pool, or start slowly."""

import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from toy_envs import DIE, IDLE, RAISE, RESET, STEP, TOY, tick

from hitl_jax.envs import WalkerError, make_pool
from hitl_jax.envs.worker_pool import WorkerPool


def alive(process_id: int) -> bool:
    """Whether a process runs; a zombie does not."""
    try:
        with open(f"/proc/{process_id}/stat") as file:
            return file.read().rpartition(")")[2].split()[0] not in "ZX"
    except FileNotFoundError:
        return False


def test_more_workers_than_walkers_and_no_orphans():
    with make_pool("gymnasium", 2, 8, TOY) as pool:
        workers = pool.process_ids
        assert len(workers) == 2
        for worker in workers:
            os.kill(worker, signal.SIGINT)  # Workers ignore both signals.
            os.kill(worker, signal.SIGTERM)
        np.testing.assert_array_equal(tick(pool, RESET, seed=3).observation[:, 0], 3)
    assert not any(map(alive, workers))
    pool.close()
    with pytest.raises(RuntimeError, match="the pool is closed"):
        tick(pool, IDLE)


def test_a_pool_closes_in_mid_tick():
    pool = make_pool("gymnasium", 2, 2, TOY)
    workers = pool.process_ids
    pool.send(np.full(2, RESET), np.zeros((2, 2)), np.zeros(2))
    pool.close()
    assert not any(map(alive, workers))


@pytest.mark.parametrize(
    ("action", "line", "tries"),
    [
        (RAISE, "exited with 1: ArithmeticError: the toy broke", 1),
        (DIE, "was killed by SIGKILL", 6),
    ],
    ids=["raises", "dies"],
)
def test_a_worker_that_fails_again_is_reported(action, line, tries, capfd, caplog):
    with make_pool("gymnasium", 3, 2, TOY) as pool:
        workers = pool.process_ids
        tick(pool, RESET)
        pool.send(np.full(3, STEP), np.array([[0, 0], [action, 0], [0, 0]]), np.zeros(3))
        with pytest.raises(WalkerError) as caught:
            pool.recv()
        assert str(caught.value) == f"walker process 2 of 2 {line}"
        assert len(caplog.records) == tries - 1
        if action == RAISE:
            assert "in step" in caught.value.__notes__[0]  # the worker's traceback
        assert not any(map(alive, workers))
    assert capfd.readouterr() == ("", "")  # Nothing of the workers' own reaches the terminal.


def test_a_killed_worker_changes_no_results(caplog):
    rng = np.random.default_rng(3)
    restarts = 0
    with make_pool("lean", 3, 2) as pool, make_pool("lean", 3, 1) as whole:
        playing = np.zeros(3, bool)
        for number in range(100):
            # Idle walkers, walkers reset in mid-episode, and those whose episode has ended, too.
            command = np.where(playing, rng.choice([IDLE, STEP, STEP, STEP], 3), RESET)
            command[rng.integers(3)] = RESET if number % 20 == 0 else IDLE
            asked = command, rng.uniform(-1, 1, (3, 4)), rng.integers(0, 9, 3)
            kill = number % 25 == 10
            if kill and number < 50:  # between two ticks
                os.kill(pool.process_ids[number % 2], signal.SIGKILL)
            pool.send(*asked)
            if kill and number >= 50:  # in a tick
                os.kill(pool.process_ids[number % 2], signal.SIGKILL)
            expected, got = whole.step(*asked), pool.recv()
            for name, values in expected._asdict().items():
                np.testing.assert_array_equal(getattr(got, name), values, err_msg=name)
            restarts += kill
            playing |= command == RESET
            playing &= ~(got.terminated | got.truncated)
    assert len(caplog.records) == restarts == 4
    assert "was killed by SIGKILL; all are started again" in caplog.text


def test_a_worker_that_does_not_come_up_is_reported():
    with pytest.raises(ValueError, match="env_id 'Nope-v3': Environment `Nope` doesn't exist"):
        make_pool("gymnasium", 2, 2, "Nope-v3")
    with pytest.raises(ValueError, match="DiscreteToy-v0': actions must be flat vectors, not Disc"):
        make_pool("gymnasium", 1, 1, "toy_envs:DiscreteToy-v0")
    with pytest.raises(WalkerError, match="2 of 2 walker processes did not come up in time"):
        WorkerPool("gymnasium", TOY, 2, 2, start_seconds=0.001)


def test_a_killed_pool_leaves_no_orphans():
    program = (
        "import os, signal, numpy as np; from hitl_jax.envs import make_pool\n"
        f"pool = make_pool('gymnasium', 2, 2, {TOY!r})\n"
        "print(*pool.process_ids, flush=True)\n"
        "os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    answer = subprocess.run(
        [sys.executable, "-c", program], stdout=subprocess.PIPE, env=environment
    )
    workers = [int(word) for word in answer.stdout.split()]
    assert (answer.returncode, len(workers)) == (-signal.SIGKILL, 2)
    deadline = time.monotonic() + 5
    while any(map(alive, workers)):
        assert time.monotonic() < deadline
        time.sleep(0.02)
