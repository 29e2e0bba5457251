"""On which walkers episodes of a folder are played again."""

import pathlib
import types

import pytest

from hitl_jax.choices.registry import TRUSTED
from hitl_jax.errors import ResultsError
from hitl_jax.playback.episodes import playing_backend, playing_pool, require_repeatable


def _folder(**config):
    return types.SimpleNamespace(path=pathlib.Path("theirs"), load_config=lambda: config)


def _agent(observation_size, action_size):
    sizes = {"observation_size": observation_size, "action_size": action_size}
    return types.SimpleNamespace(config=types.SimpleNamespace(**sizes))


@pytest.mark.parametrize(
    ("made", "plays"),
    [
        ({}, "lean"),
        ({"backend": "lean"}, "lean"),
        ({"backend": "gymnasium"}, "lean"),
        ({"backend": "envpool"}, "lean"),
        ({"backend": "jax"}, "jax"),
        ({"backend": "my_team:poles"}, "my_team:poles"),
    ],
)
def test_what_made_a_folder_plays_it(made, plays, monkeypatch):
    monkeypatch.setenv(TRUSTED, "my_team")
    assert playing_backend(_folder(**made)) == plays


@pytest.mark.parametrize(
    ("made", "told"),
    [
        (
            "my_team:poles",
            "theirs/config.json: names code that would be run: backend my_team",
        ),
        ("mujoco", "theirs: made with --backend mujoco: backend mujoco: must be one of lean, "),
    ],
)
def test_what_cannot_be_had_is_one_line(made, told, monkeypatch):
    monkeypatch.delenv(TRUSTED, raising=False)
    with pytest.raises(ResultsError, match=told):
        playing_backend(_folder(backend=made))


@pytest.mark.parametrize("made", ["envpool", "my_team:poles", "registered-by-a-program"])
def test_an_episode_is_had_again_of_our_walkers_alone(made):
    with pytest.raises(ResultsError, match=f"made with --backend {made}, whose episodes cannot"):
        require_repeatable(_folder(backend=made))
    require_repeatable(_folder(backend="gymnasium"))


def test_a_pool_of_ones_own_plays_and_is_closed(monkeypatch):
    monkeypatch.setenv(TRUSTED, "my_team")
    folder = _folder(backend="my_team:poles")
    with playing_pool(folder, _agent(3, 1), 2) as pool:
        assert pool.num_walkers == 2
    assert pool._closed


@pytest.mark.parametrize(
    ("sizes", "told"),
    [
        ((24, 1), "observation_size 24: must be 3, as the walkers have"),
        ((3, 4), "action_size 4: must be 1, as the walkers have"),
    ],
)
def test_a_pool_of_other_sizes_is_refused(sizes, told, monkeypatch):
    monkeypatch.setenv(TRUSTED, "my_team")
    playing = playing_pool(_folder(backend="my_team:poles"), _agent(*sizes), 2)
    with pytest.raises(ResultsError, match=f"--backend my_team:poles: {told}"), playing:
        pass
