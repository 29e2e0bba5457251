"""A thousand generated bad inputs: a clear line each, never a traceback, never a wrong resume."""

import errno
import os
import shutil

import hypothesis
import hypothesis.strategies as st
import numpy as np
import pytest
from example_results import CONFIG, KEY, make_episodes, make_info, make_params, make_tests
from example_saves import make_saved

from hitl_jax.analysis.summary import write_summary
from hitl_jax.console.cli import BadInput, checking_input, parse
from hitl_jax.errors import ResultsError
from hitl_jax.results import atomic_files
from hitl_jax.results.folder import ResultsFolder
from hitl_jax.results.recorded_episodes import Recording
from hitl_jax.results.run_key import RunKey
from hitl_jax.sweep.options import SweepOptions
from hitl_jax.training.saved_run_store import Saves

_CAPACITY = 8
_OTHER = RunKey("srl", 0)


def many(examples):
    return hypothesis.settings(
        max_examples=examples,
        deadline=None,
        derandomize=True,
        suppress_health_check=[hypothesis.HealthCheck.function_scoped_fixture],
    )


def _assert_one_line(said, names=""):
    assert said
    assert names in said
    assert "\n" not in said


# ------------------------------------------------------------------------------ command lines

_NAMES = """
preset methods seeds first-seed episodes test-episodes backend workers slots out save-seconds
human-policy learner hidden-sizes batch-size n-step boundary-source indicator danger intervention
release feedback-schedule observation-size capacity chunk updates-per-step gamma exploration-noise
noise-correlation warmup-steps initial-boundary delta-minus boundary-low boundary-high alarm-reward
takeover-steps human.tolerance human.delay human.miss-rate nothing
"""
_WORDS = "-1 0 1 7 2.5 nan inf -inf 1e400 None True ddpg srl hitl-ac rule 0x10 1_000 -- - ü [] full"


@many(100)
@hypothesis.given(
    st.lists(
        st.tuples(
            st.sampled_from(_NAMES.split()),
            st.lists(st.sampled_from([*_WORDS.split(), "", "9" * 30, "a b"]), max_size=3),
        )
    )
)
def test_any_command_line_is_right_or_explained_in_one_line(options):
    line = [word for name, values in options for word in (f"--{name}", *values)]
    try:
        with checking_input():
            asked = parse(SweepOptions, line).checked()
    except BadInput as error:
        _assert_one_line(str(error))
    else:
        assert np.isfinite(asked.hyper.gamma)


# -------------------------------------------------------------------------------------- files
# What is damaged: tests/attacks.


def _save(folder, key):
    steps = np.linspace(-1, 1, 270, dtype=np.float32).reshape(30, 9)
    steps[:, -4:] = steps[:, -4:] > 0
    recorded = {"best": Recording(2, steps)}
    episodes = make_episodes() | {"length": np.full(4, len(steps))}
    files = episodes, make_tests(), make_params(), make_info()
    folder.save_run(key, *files, recordings=recorded)


# ---------------------------------------------------------------------------------- a full disk


def _session(folder):
    """What a sweep writes, in its order; what is finished is not written again."""
    saves = Saves(folder.path / "under_way", _CAPACITY)
    folder.create_or_resume(CONFIG, "command")
    for key in (KEY, _OTHER):
        if key not in folder.finished():
            runs, notes = saves.load()
            assert notes == []
            ticks = runs[key].facts["ticks"] if key in runs else 0
            saves.write([make_saved(ticks + 4, 4, key)])
            folder.write_partial(key, make_episodes(2))
            _save(folder, key)
            folder.remove_partial(key)
        assert key in folder.finished()
    write_summary(folder)


def test_a_full_disk_costs_nothing_that_is_there(tmp_path, monkeypatch):
    write, left = atomic_files.write_synced, 10**6

    def full(descriptor, data):
        nonlocal left
        left -= 1
        if left < 0:
            os.write(descriptor, data[: len(data) // 2])
            raise OSError(errno.ENOSPC, "No space left on device")
        write(descriptor, data)

    monkeypatch.setattr(atomic_files, "write_synced", full)
    _session(ResultsFolder(tmp_path / "whole"))
    writes = 10**6 - left
    assert writes > 15
    kept = 0
    for number in range(writes):
        folder = ResultsFolder(tmp_path / str(number))
        left = number
        with pytest.raises(ResultsError, match=r"/\S+: No space left on device$"):
            _session(folder)
        before = folder.finished()
        assert len(before) >= kept  # What a longer session had written, a shorter one has not lost.
        kept = len(before)
        left = 10**6
        _session(folder)  # There is space again.
        for key in before:
            np.testing.assert_array_equal(
                folder.load_run(key).episodes["return"], make_episodes()["return"]
            )
        shutil.rmtree(folder.path)
    assert kept == 2


def test_a_folder_that_vanishes_is_not_made_anew(tmp_path):
    folder = ResultsFolder(tmp_path / "out")
    folder.create_or_resume(CONFIG, "command")
    saves = Saves(folder.path / "under_way", _CAPACITY)
    shutil.rmtree(folder.path)
    for write in (
        lambda: _save(folder, KEY),
        lambda: folder.write_partial(KEY, make_episodes(2)),
        lambda: saves.write([make_saved(4, 4)]),
    ):
        with pytest.raises(ResultsError, match="out"):
            write()
    assert not folder.path.exists()
