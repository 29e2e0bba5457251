"""One more number an episode is one more line in one file; older folders are still read."""

import json
import os
import pathlib
import shutil
import subprocess
import sys

import pytest

pytestmark = pytest.mark.slow

_TESTS = pathlib.Path(__file__).parents[1]
_PACKAGE = _TESTS.parent / "hitl_jax"
_LINE = (
    '    Measure("best_reward", lambda e, _: float(e.reward.max()), NAN, "number",'
    " may_be_nan=True, absent=NAN),\n"
)
_SWEEP = [
    *("sweep", "--seeds", "1", "--methods", "srl", "--episodes", "3", "--test-episodes", "2"),
    *("--backend", "my_team:poles", "--observation-size", "3", "--action-size", "1"),
    *("--learner", "ddpg", "--hidden-sizes", "8", "--batch-size", "8"),
    *("--indicator", "my_team:tilt", "--danger", "my_team:steep"),
    *("--human-actions", "my_team:hand", "--warmup-steps", "40", "--capacity", "400"),
]
_READ = """
import json, sys
from hitl_jax.__main__ import main
from hitl_jax.results.folder import ResultsFolder
words, new, old = sys.argv[1:]
assert main([*json.loads(words), "--out", new]) == 0
[mine] = ResultsFolder(new).load_all()
assert main(["figures", old]) == 0
old = ResultsFolder(old).load_all()
told = [mine.episodes, mine.tests, mine.progress, *(run.episodes for run in old)]
print(json.dumps([table["best_reward"].tolist() for table in told]))
"""


def test_a_number_is_one_line(tmp_path):
    package = tmp_path / "hitl_jax"
    shutil.copytree(_PACKAGE, package, ignore=shutil.ignore_patterns("__pycache__"))
    path = package / "results" / "episode_measures.py"
    before, mark, after = path.read_text().partition('    Measure("alarms_before_fall"')
    path.write_text(before + _LINE + mark + after)
    shutil.copytree(_TESTS / "old_folder" / "sweep", tmp_path / "old")
    done = subprocess.run(
        [sys.executable, "-c", _READ, json.dumps(_SWEEP), tmp_path / "mine", tmp_path / "old"],
        env=os.environ | {"PYTHONPATH": os.pathsep.join([str(tmp_path), str(_TESTS)])},
        capture_output=True,
        text=True,
        cwd=tmp_path,
    )
    assert done.returncode == 0, done.stderr
    training, tests, progress, *older = json.loads(done.stdout.splitlines()[-1])
    assert len(training) == 3 and all(0.0 < reward <= 1.0 for reward in training)
    assert len(tests) == 2 and all(0.0 < reward <= 1.0 for reward in tests)
    assert progress
    assert len(older) == 6
    # An older folder has no such number.
    assert all(reward != reward for run in older for reward in run)
    header = (tmp_path / "mine/runs/srl/seed-0000/episodes.csv").read_text().splitlines()[0]
    assert header.endswith("final_boundary,best_reward,alarms_before_fall,lead_steps")
