"""The lean walker equals gymnasium's to the last bit: 8 whole episodes, and 200 in slow tests."""

import pathlib

import numpy as np
import official as theirs
import pytest

from hitl_jax.envs import OUR_WALKERS, Command, StepBatch, make_pool

WALKER, HARDCORE = OUR_WALKERS
RESULTS = pathlib.Path(__file__).parents[2] / "results"


class RandomPlay:
    """Uniform actions, some outside [-1, 1], which the walker clips."""

    def __init__(self, walkers):
        self.rngs = [np.random.default_rng(walker) for walker in range(walkers)]

    def begin(self, walker):
        pass

    def act(self, observation):
        return np.array([rng.uniform(-1.2, 1.2, 4) for rng in self.rngs])


class ScriptedPlay:
    """Gymnasium's scripted player."""

    def __init__(self, walkers):
        self.gaits = [None] * walkers

    def begin(self, walker):
        self.gaits[walker] = theirs.gait()

    def act(self, observation):
        rows = zip(self.gaits, observation, strict=True)
        return np.array([gait(row) for gait, row in rows])


class TrainedPlay:
    """The policy of a published run."""

    def __init__(self, walkers):
        self.params = np.load(sorted(RESULTS.glob("**/params.npz"))[0])

    def begin(self, walker):
        pass

    def act(self, observation):
        hidden = observation
        for layer in ("Dense_0", "Dense_1"):
            hidden = np.maximum(self.apply(layer, hidden), 0)
        return np.tanh(self.apply("Dense_2", hidden))

    def apply(self, layer, inputs):
        prefix = f"actor/params/{layer}"
        return inputs @ self.params[f"{prefix}/kernel"] + self.params[f"{prefix}/bias"]


@theirs.needs_official
@pytest.mark.parametrize(
    ("env_id", "play", "walkers", "episodes"),
    [
        (WALKER, ScriptedPlay, 4, 1),
        (HARDCORE, RandomPlay, 4, 1),
        *(
            pytest.param(*case, marks=pytest.mark.slow)
            for case in (
                (WALKER, RandomPlay, 20, 3),
                (WALKER, ScriptedPlay, 25, 2),
                (WALKER, TrainedPlay, 25, 2),
                (HARDCORE, RandomPlay, 10, 2),
                (HARDCORE, ScriptedPlay, 10, 2),
            )
        ),
    ],
)
def test_lean_equals_gymnasium_to_the_last_bit(env_id, play, walkers, episodes):
    with (
        make_pool("lean", walkers, 2, env_id) as lean,
        make_pool("gymnasium", walkers, 2, env_id) as official,
    ):
        player = play(walkers)
        command = np.full(walkers, Command.RESET, np.uint8)
        observation = np.zeros((walkers, 24), np.float32)
        seeds = np.arange(walkers, dtype=np.uint32)
        ended = np.zeros(walkers, int)
        while (ended < episodes).any():
            for walker in np.flatnonzero(command == Command.RESET):
                player.begin(walker)
            action = player.act(observation).astype(np.float32)
            for pool in (lean, official):
                pool.send(command, action, seeds)
            answer, expected = lean.recv(), official.recv()
            for name, got, want in zip(StepBatch._fields, answer, expected, strict=True):
                np.testing.assert_array_equal(got, want, err_msg=name)
            observation = expected.observation
            over = expected.terminated | expected.truncated
            ended += over
            seeds = np.where(over, seeds + walkers, seeds).astype(np.uint32)
            command = np.where(over, Command.RESET, Command.STEP)
            command = np.where(ended < episodes, command, Command.IDLE).astype(np.uint8)
