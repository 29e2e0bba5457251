"""A user's own environments are played unchanged in a pool, or refused in one line."""

import os
import re
import signal
import subprocess
import sys

import numpy as np
import pytest
from own_envs import BOXES, REFUSED_BOXES, REFUSED_VIEWS
from toy_envs import RESET, STEP, make_plain, tick

from hitl_jax.envs import WalkerError, make_pool

AS_THEY_ARE = [
    "LowGravity",
    "NoSleep",
    "Moon",
    "SmoothedLow",
    "Wrapped",
    "Settled",
    "Wide",
    "Whole",
    "RewardInArray",
    "KeepsAction",
]


def plain_episode(env_id, seed, actions):
    """Rows (observation, reward, terminated, truncated) of a new environment."""
    env = make_plain(env_id, disable_env_checker=True)
    observation, _ = env.reset(seed=seed)
    rows = [(*observation, 0.0, False, False)]
    for action in actions:
        observation, reward, *ends, _ = env.step(action.copy())
        rows.append((*observation, *np.ravel(reward), *ends))
        if any(ends):
            break
    return np.array(rows, np.float32)


def pool_episode(pool, seed, actions, kill_at=-1):
    """The same rows, from a pool of one walker; its worker is killed before step `kill_at`."""
    rows = []
    for number in range(len(actions) + 1):
        if number == kill_at:
            os.kill(pool.process_ids[0], signal.SIGKILL)
        if number == 0:
            batch = tick(pool, RESET, seed=seed)
        else:
            batch = tick(pool, STEP, actions[number - 1])
        ends = batch.terminated[0], batch.truncated[0]
        rows.append((*batch.observation[0], batch.reward[0], *ends))
        if any(ends):
            break
    return np.array(rows, np.float32)


# ------------------------------------------------------------------------------ episodes


@pytest.mark.parametrize("name", AS_THEY_ARE)
def test_an_own_environment_is_played_unchanged(name, caplog):
    """A seed's episode is equal to the last bit, in any order and after a worker was killed."""
    env_id = f"own_envs:{name}-v0"
    with make_pool("gymnasium", 1, env_id=env_id) as pool:
        rng = np.random.default_rng(0)
        actions = rng.uniform(-1, 1, (90, pool.action_size)).astype(np.float32)
        truth = {seed: plain_episode(env_id, seed, actions) for seed in (6, 7, 8)}
        for seed in (6, 7, 6, 8, 7):
            np.testing.assert_array_equal(pool_episode(pool, seed, actions), truth[seed])
        again = pool_episode(pool, 7, actions, kill_at=9)
        np.testing.assert_array_equal(again, truth[7])
        assert "was killed by SIGKILL" in caplog.text


def test_the_users_gravity_is_used():
    actions = np.zeros((30, 4), np.float32)
    low = plain_episode("own_envs:LowGravity-v0", 3, actions)
    assert not np.array_equal(low, plain_episode("BipedalWalker-v3", 3, actions))
    with make_pool("gymnasium", 1, env_id="own_envs:LowGravity-v0") as pool:
        np.testing.assert_array_equal(pool_episode(pool, 3, actions), low)


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("NormalObservation", "NormalizeObservation takes something over from the episodes before"),
        ("NormalReward", "NormalizeReward takes something over"),
        ("RunningLargest", "an episode takes something over"),
        ("RunningReward", "an episode takes something over"),
        ("Harder", "an episode takes something over"),
        ("Counted", "two new environments play the same seed and actions differently"),
        ("Unseeded", "two new environments"),
        ("Clock", "two new environments"),
        ("Misshapen", r"an observation has shape \(1,\): its space says \(2,\)"),
    ],
)
def test_episodes_that_depend_on_more_than_seed_and_actions_are_refused(name, reason):
    with pytest.raises(ValueError, match=f"^env_id 'own_envs:{name}-v0': {reason}") as caught:
        make_pool("gymnasium", 1, 1, f"own_envs:{name}-v0")
    assert "\n" not in str(caught.value)


# ------------------------------------------------------------------------------- actions


@pytest.mark.parametrize("name", BOXES)
def test_actions_reach_all_of_the_box(name):
    box = BOXES[name]
    with make_pool("gymnasium", 2, 1, f"own_envs:{name}-v0") as pool:
        tick(pool, RESET)

        def given(action):
            seen = tick(pool, STEP, action).observation[0]
            assert seen[-1] == (name != "FineUnit")  # An action of the box's own type.
            return seen[:-1]

        np.testing.assert_array_equal(given(-1.0), box.low.astype(np.float32))
        np.testing.assert_array_equal(given(1.0), box.high.astype(np.float32))
        middle = (box.low / 2 + box.high / 2).astype(np.float32)
        np.testing.assert_allclose(given(0.0), middle, rtol=1e-6, atol=1e-8)
        if name in ("Unit", "FineUnit"):  # As before, to the last bit; it is the environment's.
            for action in (1e-9, 0.1, np.nextafter(np.float32(1), np.float32(0)), 1.5):
                np.testing.assert_array_equal(given(action), np.float32(action))
        else:
            np.testing.assert_array_equal(given(1.5), box.high.astype(np.float32))
            np.testing.assert_array_equal(given(-7.0), box.low.astype(np.float32))


def test_half_of_an_asymmetric_box():
    with make_pool("gymnasium", 1, env_id="own_envs:Each-v0") as pool:
        tick(pool, RESET)
        seen = tick(pool, STEP, 0.5).observation[0, :4]
    np.testing.assert_allclose(seen, [0.5, 2.25, 0.0, 5.0], atol=1e-7)  # mid + half of half


def test_pendulum():
    """Gymnasium's own with another range, [-2, 2]."""
    actions = np.random.default_rng(1).uniform(-1, 1, (40, 1)).astype(np.float32)
    with make_pool("gymnasium", 1, env_id="Pendulum-v1") as pool:
        seen = pool_episode(pool, 5, actions)
    np.testing.assert_array_equal(seen, plain_episode("Pendulum-v1", 5, 2 * actions))


@pytest.mark.parametrize("name", [*REFUSED_BOXES, *REFUSED_VIEWS])
def test_other_spaces_are_refused(name):
    what = "observation" if name in REFUSED_VIEWS else "action"
    with pytest.raises(ValueError, match=rf"^env_id 'own_envs:{name}-v0': {what}s must ") as caught:
        make_pool("gymnasium", 1, 1, f"own_envs:{name}-v0")
    assert "\n" not in str(caught.value)


# --------------------------------------------------------------------------------- names


@pytest.mark.parametrize(
    ("env_id", "line"),
    [
        ("Mine-v0", "Environment `Mine` doesn't exist.*'module:Mine-v0': walkers are played in"),
        ("MountainCarContinous-v0", "Did you mean: `MountainCarContinuous`"),
        ("BipedalWalker-v9", "Environment version `v9` for environment `BipedalWalker` doesn't"),
        ("own_envs:Mine-v0", "doesn't exist.* Module 'own_envs' does not register it"),
        ("not_there:Mine-v0", "No module named 'not_there'"),
        ("own_envs:NoMujoco-v0", "No module named 'a_simulator_that_is_not_there'"),
        ("Mine v0", "[Mm]alformed environment ID"),
        ("", "must name an environment"),
        (None, "must be a string"),
    ],
)
def test_unknown_names_are_refused(env_id, line):
    with pytest.raises(ValueError, match=rf"^env_id {re.escape(repr(env_id))}: .*{line}") as caught:
        make_pool("gymnasium", 1, 1, env_id)
    assert "\n" not in str(caught.value)


_MINE = """
import gymnasium, numpy as np
class Mine(gymnasium.Env):
    observation_space = gymnasium.spaces.Box(-9, 9, (1,), np.float32)
    action_space = gymnasium.spaces.Box(-1, 1, (1,), np.float32)
    def reset(self, *, seed=None, options=None):
        return np.float32([seed]), {}
    def step(self, action):
        return action, 0.0, False, False, {}
gymnasium.register("Mine-v0", Mine)
"""
_PLAY = """
from hitl_jax.envs import make_pool
with make_pool("gymnasium", 1, env_id={env_id!r}) as pool:
    print(pool.step([2], [[0.0]], [7]).observation)
"""


def _run(words, folder):
    """Runs a user's program; its output, and the last line of its errors."""
    path = os.pathsep.join(filter(None, sys.path))
    environment = {**os.environ, "PYTHONPATH": path}
    done = subprocess.run(
        [sys.executable, *words], cwd=folder, env=environment, capture_output=True, text=True
    )
    return done.stdout.strip(), (done.stderr.strip().splitlines() or [""])[-1]


@pytest.fixture
def scripts(tmp_path):
    """A user's folder with a module of environments and scripts, and another folder beside it."""
    mine, elsewhere = tmp_path / "mine", tmp_path / "elsewhere"
    mine.mkdir()
    elsewhere.mkdir()
    (mine / "mine_envs.py").write_text(_MINE)
    (mine / "twice.py").write_text(f"import mine_envs\n{_MINE}")
    (mine / "broken.py").write_text(f"{_MINE}\n1 / 0\n")
    (mine / "play.py").write_text(_PLAY.format(env_id="mine_envs:Mine-v0"))
    (mine / "alone.py").write_text(_MINE + _PLAY.format(env_id="Mine-v0"))
    indented = _PLAY.format(env_id="guarded:Mine-v0").replace("\n", "\n    ")
    (mine / "guarded.py").write_text(f"{_MINE}if __name__ == '__main__':{indented}\n")
    (mine / "unguarded.py").write_text(_MINE + _PLAY.format(env_id="unguarded:Mine-v0"))
    return mine, elsewhere


def test_modules_beside_the_script_are_found(scripts):
    mine, elsewhere = scripts
    assert _run(["../mine/play.py"], elsewhere) == ("[[7.]]", "")
    assert _run(["guarded.py"], mine) == ("[[7.]]", "")


@pytest.mark.slow
def test_modules_are_found_from_wherever_python_is_started(scripts):
    mine, elsewhere = scripts
    play = _PLAY.format(env_id="mine_envs:Mine-v0")
    assert _run(["play.py"], mine) == ("[[7.]]", "")
    assert _run(["-m", "play"], mine) == ("[[7.]]", "")
    assert _run(["-c", play], mine) == ("[[7.]]", "")  # as in a notebook
    assert _run(["-c", f"import sys; sys.path.append('../mine'){play}"], elsewhere)[0] == "[[7.]]"
    assert _run(["-c", _PLAY.format(env_id="twice:Mine-v0")], mine)[0] == "[[7.]]"


def test_scripts_that_cannot_work_get_a_reason(scripts):
    mine, elsewhere = scripts
    assert "name that too, 'module:Mine-v0'" in _run(["alone.py"], mine)[1]
    told = _run(["unguarded.py"], mine)[1]
    assert "env_id 'unguarded:Mine-v0': a walker's process makes no pools" in told
    assert (
        "No module named 'mine_envs'"
        in _run(["-c", _PLAY.format(env_id="mine_envs:Mine-v0")], elsewhere)[1]
    )


def test_an_error_in_a_module_shows_its_place(scripts, monkeypatch):
    monkeypatch.syspath_prepend(scripts[0])
    with pytest.raises(WalkerError, match="exited with 1: ZeroDivisionError: division") as caught:
        make_pool("gymnasium", 1, env_id="broken:Mine-v0")
    assert "broken.py" in caught.value.__notes__[0]


# -------------------------------------------------------------------------------- counts


@pytest.mark.parametrize("kind", [int, np.int64, np.int32, np.uint8, np.array])
def test_integers_of_any_type_are_accepted(kind):
    with make_pool("gymnasium", kind(3), kind(2), "own_envs:Unit-v0", seed=kind(5)) as pool:
        assert (pool.num_walkers, len(pool.process_ids)) == (3, 2)


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        ({"num_walkers": True}, "num_walkers True: must be a whole number of at least 1"),
        ({"num_walkers": np.True_}, "num_walkers .*True.*: must be"),
        ({"num_walkers": np.float64(2)}, r"num_walkers .*2\.0.*: must be"),
        ({"num_walkers": "2"}, "num_walkers '2': must be"),
        ({"num_walkers": np.int64(0)}, "num_walkers .*0.*: must be"),
        ({"num_workers": 1.0}, r"num_workers 1\.0: must be"),
        ({"num_workers": np.array([1, 2])}, "num_workers .*: must be"),
        ({"seed": -5}, "seed -5: must be a whole number of at least 0 and at most 2147483647"),
        ({"seed": 2**31}, "seed 2147483648: must be"),
        ({"seed": 1.5}, r"seed 1\.5: must be"),
        ({"seed": None}, "seed None: must be"),
        ({"seed": True}, "seed True: must be"),
    ],
)
def test_other_counts_are_refused(arguments, line):
    with pytest.raises(ValueError, match=f"^{line}"):
        make_pool(**({"backend": "gymnasium", "num_walkers": 1} | arguments))
