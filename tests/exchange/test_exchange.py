"""Episodes go to Minari and back, a human is fitted to them, and a sweep has that human."""

import json
import pathlib

import jax
import numpy as np
import pytest
import small
from live_team import setup_of

from hitl_jax.commands import alarms, export, import_human
from hitl_jax.commands.seed_sweep import main
from hitl_jax.console.cli import run_main
from hitl_jax.errors import ResultsError
from hitl_jax.exchange import fitting, minari_files, of_journal
from hitl_jax.exchange.played import Played, Source
from hitl_jax.human import HumanParams
from hitl_jax.human.fitted import hands_of, judge_of, require_fitted
from hitl_jax.live import journal, messages
from hitl_jax.live.session import Session
from hitl_jax.results.folder import ResultsFolder
from hitl_jax.results.run_key import RunKey
from hitl_jax.sweep import fitted_human, run_sweep

_SMALL = [
    *("--seeds", "1", "--episodes", "2", "--test-episodes", "4", "--warmup-steps", "100"),
    *("--methods", "hitl-ac", "--backend", "lean", *small.OPTIONS),
]
_ID = "walker/small-v0"
_KEY = jax.random.key(0)


def _episode(seed, steps=300, delay=10):
    """A person sees danger where the first number was above 1, and then pushes against it."""
    rng = np.random.default_rng(seed)
    seen = np.cumsum(rng.normal(size=(steps + 1, 24)), 0).astype(np.float32) * 0.3
    seen -= 0.05 * np.arange(steps + 1)[:, None] * (seen > 2)
    dangerous = np.zeros(steps, bool)
    dangerous[delay:] = seen[: steps - delay, 0] > 1.0
    actions = rng.uniform(-1, 1, (steps, 4)).astype(np.float32)
    actions[dangerous] = np.tanh(-seen[:-1][dangerous][:, :4] / 3)
    ends = np.arange(steps) == steps - 1
    return Played(
        name=f"{seed}",
        seed=seed,
        observations=seen,
        actions=actions,
        rewards=rng.normal(size=steps).astype(np.float32),
        terminated=ends & (seed % 2 == 0),
        truncated=ends & (seed % 2 == 1),
        boundary=np.full(steps, 0.5, np.float32),
        alarmed=dangerous,
        dangerous=dangerous,
        human_action=dangerous,
        judged=np.arange(steps) >= 5,
    )


@pytest.fixture(scope="module", autouse=True)
def _quick():
    """Fewer delays are tried, and shorter."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fitting, "_DELAYS", (0, 10, 30))
        patch.setattr(fitting, "_LOOKS", 6)
        yield


@pytest.fixture(scope="module")
def episodes():
    return [_episode(seed) for seed in range(20)]


@pytest.fixture(scope="module")
def fit(episodes):
    return fitting.fit(episodes)


def test_a_fitted_human_judges_as_the_person_did(fit, episodes):
    assert fit.delay == 10
    assert fit.agrees > 0.95 and fit.missed < 0.2 and fit.feared < 0.1
    assert fit.explained > 0.8
    require_fitted(fit.arrays)
    judge = judge_of(fit.arrays)
    state, said = judge.begin_episode(judge.init()), []
    fresh = _episode(99)
    for observation in fresh.observations[:-1]:
        state, dangerous = judge.judge(state, HumanParams(delay=3), observation, False, _KEY)
        said.append(bool(dangerous))
    assert np.mean(np.array(said) == fresh.dangerous) > 0.9
    assert not any(said[:10])
    _, action = hands_of(fit.arrays).act((), fresh.observations[0], _KEY)
    assert action.shape == (4,)


@pytest.mark.slow
def test_too_little_is_refused(episodes):
    with pytest.raises(ResultsError, match="590 judged steps of 2 episodes that are longer than"):
        fitting.fit(episodes[:2])
    nobody = [one._replace(judged=np.zeros(300, bool)) for one in episodes]
    with pytest.raises(ResultsError, match=r"^0 judged steps of 0 episodes"):
        fitting.fit(nobody)
    # Who judged in a few episodes alone, and at their beginnings alone.
    few = [one._replace(judged=one.judged & (place % 5 > 1)) for place, one in enumerate(episodes)]
    assert fitting.fit(few).agrees > 0.8
    early = [one._replace(judged=np.arange(300) < 30) for one in episodes]
    with pytest.raises(ResultsError, match=r"^0 judged steps of 0 episodes"):
        fitting.fit(early)
    quiet = [one._replace(human_action=np.zeros(300, bool)) for one in episodes[:5]]
    assert hands_of(fitting.fit(quiet).arrays) is None


def test_a_dataset_comes_back_as_it_was(episodes, tmp_path):
    minari = pytest.importorskip("minari")
    source = Source("BipedalWalker-v3", "made up", iter(episodes[:3]))
    assert minari_files.write(tmp_path, _ID, source) == (3, 900)
    for one, other in zip(minari_files.read(tmp_path, _ID), episodes, strict=False):
        for name in set(Played._fields) - {"name"}:
            np.testing.assert_allclose(getattr(one, name), getattr(other, name), rtol=1e-6)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
        found = minari.load_dataset(_ID)
    assert found.total_episodes == 3 and found.spec.env_spec.id == "BipedalWalker-v3"
    with pytest.raises(ResultsError, match="is there already"):
        minari_files.write(tmp_path, _ID, source)


@pytest.mark.parametrize("name", ["judged", "boundary", "actions", "observations"])
def test_a_dataset_of_strangers_is_looked_at(episodes, tmp_path, name):
    pytest.importorskip("minari")
    source = Source("BipedalWalker-v3", "made up", iter(episodes[:1]))
    minari_files.write(tmp_path, _ID, source)
    [file] = tmp_path.rglob("*.hdf5")
    h5py = pytest.importorskip("h5py")
    with h5py.File(file, "r+") as data:
        folder = data["episode_0"]
        where = folder["infos"] if name in minari_files.INFOS else folder
        held = where[name][:]
        del where[name]
        where[name] = held[:-1] if name in minari_files.INFOS else np.full_like(held, np.nan)
    with pytest.raises(ResultsError, match="is no dataset to learn from"):
        minari_files.read(tmp_path, _ID)


@pytest.mark.parametrize("damage", ["delay", "network", "actor", "more", "nan", "least"])
def test_a_damaged_file_is_refused(fit, damage):
    arrays = dict(fit.arrays)
    if damage == "delay":
        arrays["delay"] = np.array(33, np.int32)
    elif damage == "network":
        del arrays["network/params/Dense_1/bias"]
    elif damage == "actor":
        arrays["actor/params/Dense_0/kernel"] = np.zeros((7, 64), np.float32)
    elif damage == "more":
        arrays["other"] = np.zeros(1)
    elif damage == "nan":
        kernel = arrays["network/params/Dense_0/kernel"]
        arrays["network/params/Dense_0/kernel"] = np.full_like(kernel, np.nan)
    else:
        arrays["least_expectation"] = np.array(np.nan, np.float32)
    with pytest.raises(ValueError, match=r"\w"):
        require_fitted(arrays)


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    out = tmp_path_factory.mktemp("swept") / "out"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run_sweep, "draw", lambda _: [])
        assert run_main("sweep", main, [*_SMALL, "--out", str(out)]) == 0
    return out


@pytest.mark.slow
def test_a_sweep_goes_to_minari_and_a_human_of_it_into_the_next(
    swept, tmp_path, capsys, monkeypatch
):
    pytest.importorskip("minari")
    root = ["--out", str(tmp_path)]
    words = [str(swept), "--phase", "autonomous", "--id", _ID, *root]
    assert run_main("export", export.main, words) == 0
    tests = ResultsFolder(swept).load_run(RunKey("hitl-ac", 0)).tests
    alone = tests["return"][tests["mode"] == "autonomous"]
    played = minari_files.read(tmp_path, _ID)
    np.testing.assert_allclose([one.rewards.sum() for one in played], alone, rtol=1e-4)
    assert run_main("export", export.main, words) == 2
    assert "is there already" in capsys.readouterr().err
    assert run_main("import", import_human.main, [_ID, "--root", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert "judgements: agrees on " in said
    file = tmp_path / "walker-small-v0.fitted.npz"
    assert f"--human fitted:{file}" in said
    monkeypatch.setattr(run_sweep, "draw", lambda _: [])
    out = tmp_path / "again"
    words = [*_SMALL, "--human", f"fitted:{file}", "--out", str(out)]
    assert run_main("sweep", main, words) == 0
    config = json.loads((out / "config.json").read_text())["config"]
    assert config["fitted_human"].startswith("sha256:")
    assert (out / "fitted_human.npz").read_bytes() == file.read_bytes()
    assert run_main("alarms", alarms.main, [str(out)]) == 0
    (out / "fitted_human.npz").write_bytes(b"")
    assert run_main("alarms", alarms.main, [str(out)]) == 2


def test_a_persons_session_has_their_labels_and_the_walkers_rewards(tmp_path):
    path = tmp_path / "journal.jsonl"
    session, noted = Session(setup_of()), journal.Journal(path)
    noted.begin({"mode": "train"})
    said = {20: {"type": "danger", "down": True, "frame": 18}}
    said |= {40: {"type": "danger", "down": False, "frame": 38}}
    while len(session.episodes) < 2:
        number = session.frame.number
        if number in said:
            noted.said(session, messages.parse(json.dumps(said[number])))
        session.tick()
        noted.played(session)
    while session.frame.number % session.setup.loop.chunk:
        session.tick()
        noted.played(session)
    noted.close()
    _, lines = journal.read(path)
    first, second, *_ = of_journal._played(Session(setup_of()), lines, pathlib.Path("me"))
    for one, row in zip((first, second), session.episodes, strict=False):
        assert len(one.rewards) == row["length"] == len(one.observations) - 1
        np.testing.assert_allclose(one.rewards.sum(), row["return"], rtol=1e-5)
        assert one.terminated[-1] or one.truncated[-1]
        assert not (one.terminated | one.truncated)[:-1].any()
    assert first.dangerous[18:38].all() and not first.dangerous[:18].any()
    assert first.seed != second.seed and first.judged.all()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["nowhere", "--id", "walker"], "--id walker: must be like walker/session-v0"),
        (["nowhere", "--id", _ID], "nowhere: No such file"),
        (["nowhere", "--id", _ID, "--methods", "none"], "--methods none: must be one of srl"),
    ],
)
def test_bad_exports_are_one_line(words, said, capsys):
    pytest.importorskip("minari")
    assert run_main("export", export.main, words) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"error: {said}") and error.count("\n") == 1


def test_a_human_that_cannot_be_read_is_one_line(tmp_path, capsys):
    (tmp_path / "bad.npz").write_bytes(b"no")
    for name, said in (("bad.npz", "is no fitted human: "), ("none.npz", "No such file")):
        words = [*_SMALL, "--human", f"{fitted_human.PREFIX}{tmp_path / name}"]
        assert run_main("sweep", main, [*words, "--out", str(tmp_path / "out")]) == 2
        assert f"error: --human {tmp_path / name}: {said}" in capsys.readouterr().err
    words = [*_SMALL, "--human", "fitted:x.npz", "--danger", "threshold"]
    assert run_main("sweep", main, words) == 2
    said = "error: --danger: has no meaning beside --human fitted:FILE, who judges as they were"
    assert said in capsys.readouterr().err
