"""Pools give what a plain gymnasium loop gives, and refuse bad ticks and arguments."""

import os
import subprocess
import sys

import numpy as np
import pytest
from toy_envs import (
    GOAL,
    IDLE,
    RAISE,
    RESET,
    STEP,
    TOY,
    make_plain,
    same,
    tick,
)

from hitl_jax.envs import BACKENDS, StepBatch, make_pool


class PlainLoop:
    """What a pool must do: a new gymnasium environment for each episode."""

    def __init__(self, env_id: str, num_walkers: int):
        self.env_id = env_id
        self.envs = [None] * num_walkers
        self.observations = [np.zeros(24, np.float32)] * num_walkers

    def step(self, command, action, seed) -> StepBatch:
        rows = []
        for i, order in enumerate(command):
            row = (0.0, False, False)
            if order == RESET:
                self.envs[i] = make_plain(self.env_id)
                self.observations[i], _ = self.envs[i].reset(seed=int(seed[i]))
            elif order == STEP:
                self.observations[i], *row, _ = self.envs[i].step(action[i])
            rows.append((self.observations[i], *row))
        observation, *scalars = map(np.array, zip(*rows, strict=True))
        return StepBatch(observation, scalars[0].astype(np.float32), *scalars[1:])


class Script:
    """Commands, seeds and actions of walkers by their numbers, with idle ticks and human resets."""

    def __init__(self, who: list[int]):
        self.who = who
        self.ended = np.ones(len(who), bool)
        self.episode = np.zeros(len(who), int)

    def next(self, ticks: int):
        """The arguments of `step` for the tick."""
        action = [np.random.default_rng((w, ticks)).uniform(-1, 1, 4) for w in self.who]
        command = np.full(len(self.who), STEP)
        for i, w in enumerate(self.who):
            if w == 1 and ticks % 10 == 3:
                command[i] = IDLE
            if self.ended[i] or (w == 2 and ticks % 25 == 24):
                command[i] = RESET
        self.episode += command == RESET
        # Each walker alternates between two seeds.
        seed = 100 * np.array(self.who) + self.episode % 2
        return command.astype(np.uint8), np.array(action, np.float32), seed.astype(np.uint32)

    def see(self, command: np.ndarray, batch: StepBatch) -> None:
        self.ended = np.where(command == IDLE, self.ended, batch.terminated | batch.truncated)


def play(pool, who: list[int], ticks: int) -> StepBatch:
    """Plays a script; arrays [ticks, N, ...]."""
    script, batches = Script(who), []
    for number in range(ticks):
        command, action, seed = script.next(number)
        batches.append(pool.step(command, action, seed))
        script.see(command, batches[-1])
    return StepBatch(*map(np.stack, zip(*batches, strict=True)))


# ------------------------------------------------------------------ the official walker, and lean


@pytest.fixture(scope="module")
def plain() -> StepBatch:
    """300 ticks of walkers 0 to 4 in a plain loop."""
    return play(PlainLoop("BipedalWalker-v3", 5), [0, 1, 2, 3, 4], 300)


@pytest.mark.parametrize("backend", ["gymnasium", "lean"])
def test_a_pool_equals_a_plain_loop_to_the_last_bit(plain, backend):
    assert plain.terminated.sum() >= 3  # The script has falls, human resets and repeated seeds.
    assert (plain.reward[plain.terminated] == -100).all()
    with make_pool(backend, 5, 2) as pool:
        assert (pool.num_walkers, pool.observation_size, pool.action_size) == (5, 24, 4)
        assert pool.seedable
        same(play(pool, [0, 1, 2, 3, 4], 300), plain)


@pytest.mark.parametrize("backend", ["gymnasium", "lean"])
def test_episodes_depend_on_neither_workers_nor_other_walkers(plain, backend):
    with make_pool(backend, 3, 1) as pool:
        batch = play(pool, [4, 2, 0], 300)
    same(batch, StepBatch(*(array[:, [4, 2, 0]] for array in plain)))


def test_an_episode_does_not_depend_on_earlier_ones():
    # In a reused gymnasium environment it does: seed 7 gives another first step the second time.
    rng = np.random.default_rng(0)
    actions = rng.uniform(-1, 1, (30, 1, 4))

    def episode(pool, seed):
        batches = [tick(pool, RESET, seed=seed), *(tick(pool, STEP, a) for a in actions)]
        return StepBatch(*map(np.stack, zip(*batches, strict=True)))

    with make_pool("gymnasium", 1) as pool:
        first = {seed: episode(pool, seed) for seed in range(6, 12)}
        for seed in (11, 7, 6, 10, 7, 8, 9):
            same(episode(pool, seed), first[seed])


def test_truncation_keeps_the_true_observation():
    env = make_plain("toy_envs:ShortWalker-v0")
    env.reset(seed=5)
    with make_pool("gymnasium", 1, env_id="toy_envs:ShortWalker-v0") as pool:
        tick(pool, RESET, seed=5)
        for number in range(1, 13):
            observation, *_ = env.step(np.full(4, 0.5, np.float32))
            batch = tick(pool, STEP, 0.5)
            np.testing.assert_array_equal(batch.observation[0], observation)
            assert (batch.terminated[0], batch.truncated[0]) == (False, number == 12)


# ------------------------------------------------------------------------------- the interface


@pytest.fixture(scope="module")
def toys():
    with make_pool("gymnasium", 5, 2, TOY) as pool:
        yield pool


def test_commands_and_flags(toys):
    """Walker 0 always steps, 1 idles once, 2 is reset by a human, 3 and 4 are always idle."""
    start = tick(toys, [RESET, RESET, RESET, IDLE, IDLE], 0.9, [10, 11, 2**32 - 1, 13, 14])
    assert [array.dtype for array in start] == [np.float32, np.float32, bool, bool]
    assert not start.reward.any()
    np.testing.assert_array_equal(
        start.observation[:3], np.float32([[10, 0, 0], [11, 0, 0], [2**32 - 1, 0, 0]])
    )
    tick(toys, [STEP, STEP, STEP, IDLE, IDLE], 0.25)
    batch = tick(toys, [STEP, IDLE, RESET, IDLE, IDLE], 0.5, 22)
    np.testing.assert_array_equal(
        batch.observation[:3], np.float32([[10, 2, 0.5], [11, 1, 0.25], [22, 0, 0]])
    )
    np.testing.assert_array_equal(batch.reward, np.float32([0.5, 0, 0, 0, 0]))
    assert not batch.terminated.any()
    for _ in range(GOAL - 2):
        batch = tick(toys, [STEP, STEP, STEP, IDLE, IDLE], -1.0)
    # Walker 0 reaches the goal and the time limit in one step: both are told.
    assert (batch.terminated[0], batch.truncated[0], batch.observation[0, 1]) == (True, True, GOAL)
    np.testing.assert_array_equal(batch.observation[1:3], np.float32([[11, 4, -1], [22, 3, -1]]))
    assert not (batch.terminated | batch.truncated)[1:].any()
    # There is no automatic reset: the final observation stays, flags and reward are 0.
    batch = tick(toys, [IDLE, STEP, STEP, IDLE, IDLE])
    assert (batch.observation[0, 1], batch.reward[0], batch.terminated[0]) == (GOAL, 0, False)
    with pytest.raises(ValueError, match=r"STEP of walker 0: not in an episode, RESET it first"):
        tick(toys, [STEP, STEP, STEP, IDLE, IDLE])


def test_the_time_limit_truncates():
    with make_pool("gymnasium", 1, env_id="toy_envs:ShortToy-v0") as pool:
        tick(pool, RESET)
        flags = [tick(pool, STEP)[2:] for _ in range(3)]
    assert flags == [(False, False), (False, False), (False, True)]


def test_the_caller_may_change_all_arrays(toys):
    first = tick(toys, RESET, seed=1)
    command, action = np.full(5, STEP, np.uint8), np.full((5, 2), 0.5, np.float32)
    toys.send(command, action, np.zeros(5, np.uint32))
    command[:], action[:] = RESET, RAISE
    second = toys.recv()
    np.testing.assert_array_equal(first.observation[:, 1], 0)
    np.testing.assert_array_equal(second.observation[:, 1], 1)
    second.observation[:] = np.nan
    assert np.isfinite(tick(toys, IDLE).observation).all()


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        ((np.zeros(4), np.zeros((5, 2)), np.zeros(5)), r"command has shape \(4,\): must be \(5,\)"),
        ((np.zeros(5), np.zeros((5, 4)), np.zeros(5)), r"action has shape \(5, 4\): must be"),
        ((np.zeros(5), np.zeros((5, 2)), np.zeros(1)), r"seed has shape \(1,\): must be \(5,\)"),
        ((np.full(5, 3), np.zeros((5, 2)), np.zeros(5)), r"command 3: must be one of \[0, 1, 2\]"),
        (
            (np.eye(5)[2], np.full((5, 2), np.nan), np.zeros(5)),
            "action of walker 2: must be finite",
        ),
    ],
)
def test_a_tick_that_cannot_be_played(toys, arguments, line):
    tick(toys, RESET)
    with pytest.raises(ValueError, match=line):
        toys.step(*arguments)
    # The refused tick changed nothing; NaN actions of idle walkers are allowed.
    assert tick(toys, [STEP, *[IDLE] * 4], [[0.0] * 2, *[[np.nan] * 2] * 4]).observation[0, 1] == 1


def test_order_of_calls(toys):
    with pytest.raises(RuntimeError, match="no tick was sent"):
        toys.recv()
    toys.send(np.zeros(5), np.zeros((5, 2)), np.zeros(5))
    with pytest.raises(RuntimeError, match="call recv first"):
        toys.send(np.zeros(5), np.zeros((5, 2)), np.zeros(5))
    toys.recv()


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (("mujoco", 1), "backend mujoco: must be one of lean, gymnasium, envpool, jax"),
        (("gymnasium", 0), "num_walkers 0: must be a whole number of at least 1"),
        (("gymnasium", 2.0), "num_walkers 2.0: must be"),
        (("envpool", 4, -1), "num_workers -1: must be"),
        (("lean", 1, 1, "CartPole-v1"), "env_id 'CartPole-v1': must be one of BipedalWalker-v3, B"),
    ],
)
def test_bad_arguments(arguments, line):
    with pytest.raises(ValueError, match=line):
        make_pool(*arguments)


def test_imports_are_lazy():
    program = (
        "import sys, hitl_jax.envs.worker, hitl_jax.envs.worker_pool\n"
        "heavy = {'jax', 'flax', 'gymnasium', 'envpool', 'Box2D', 'pygame'} & sys.modules.keys()\n"
        "assert not heavy, heavy\n"
    )
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    subprocess.run([sys.executable, "-c", program], check=True, env=environment)


def test_backends():
    assert BACKENDS.names == ("lean", "gymnasium", "envpool", "jax")
