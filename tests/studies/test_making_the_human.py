"""The trained human: who has the controls when, and that both files are made and can be read."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hitl_jax.commands import human as command
from hitl_jax.console.cli import run_main
from hitl_jax.human import HumanParams, experience
from hitl_jax.human.trained_walker import FILE
from hitl_jax.learner.networks import Actor, RiskNetwork
from hitl_jax.studies import trained_human
from hitl_jax.studies.trained_human import crew_actions, relay
from hitl_jax.team.checkpoint import hidden_sizes, load_actor


def _judged(expectation, steps=4000):
    network = RiskNetwork(trained_human.EXPERIENCE_SIZES)
    expects = network.init(jax.random.key(1), jnp.zeros(24))
    bias = jnp.full(1, jax.scipy.special.logit(expectation))
    expects["params"]["Dense_2"] = {"kernel": jnp.zeros((64, 1)), "bias": bias}
    part = relay(expects, 24)
    observation = jnp.zeros(24)

    def step(state, key):
        return part.judge(state, HumanParams(), observation, jnp.zeros((), bool), key)

    keys = jax.random.split(jax.random.key(0), steps)
    return np.asarray(jax.lax.scan(step, part.begin_episode(part.init()), keys)[1])


def test_a_crew_takes_over_at_random_and_gives_back_where_a_stumble_shows():
    walks, stumbles = _judged(0.01), _judged(0.95)
    assert 0.4 < walks.mean() < 0.8
    assert walks[0] and not stumbles.any()
    changes = np.diff(walks.astype(int))
    assert (changes == 1).sum() > 10
    # Some see a stumble in an expectation of 0.2, and others do not.
    held = _judged(0.2)
    assert 0.05 < held.mean() < walks.mean() - 0.05


def test_members_of_a_crew_act_in_turns():
    actor = Actor((4,), 4)
    policies = [actor.init(jax.random.key(seed), jnp.zeros(24)) for seed in range(3)]
    source = crew_actions(policies, 24, 4)
    seen = jnp.ones(24)

    def step(member, key):
        member, action = source.act(member, seen, key)
        return member, (member, action)

    keys = jax.random.split(jax.random.key(0), 1000)
    _, (members, actions) = jax.lax.scan(step, source.init(), keys)
    assert set(np.unique(members)) == {0, 1, 2}
    for member in range(3):
        own = actor.apply(policies[member], seen)
        np.testing.assert_allclose(actions[members == member][0], own, rtol=1e-5)


@pytest.mark.slow
def test_both_files_are_made_and_read(tmp_path, capsys, monkeypatch):
    crew = {learner: (seeds[:1], share) for learner, (seeds, share) in trained_human.CREW.items()}
    monkeypatch.setattr(trained_human, "CREW", crew)
    monkeypatch.setattr(trained_human, "HANDS_SEEDS", range(2))
    monkeypatch.setattr(trained_human, "_UPDATES", 100)
    small = {"hidden_sizes": (16, 16), "batch_size": 16}
    monkeypatch.setattr(trained_human, "_ALL", trained_human._ALL | small)
    words = ["--crew-episodes", "16", "--episodes", "2", "--test-episodes", "1"]
    out = tmp_path / "hands"
    assert run_main("human", command.main, [*words, "--out", str(out)]) == 0
    assert capsys.readouterr().out.count("with the crew") == 2
    actor = load_actor(out / FILE, 24, 4)
    assert hidden_sizes(actor) == (16, 16, 4)
    with np.load(out / experience.FILE) as arrays:
        assert arrays["network/params/Dense_2/kernel"].shape == (64, 1)


def test_bad_options_are_one_line(tmp_path, capsys):
    assert run_main("human", command.main, ["--crew-episodes", "15"]) == 2
    assert "error: --crew-episodes 15: must be at least 16" in capsys.readouterr().err
    (tmp_path / "file").touch()
    assert run_main("human", command.main, ["--out", str(tmp_path / "file")]) == 2
    assert "error: --out" in capsys.readouterr().err
