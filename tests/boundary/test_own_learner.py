"""A boundary learner of one's own is put in place of ours, and refused in one line if faulty."""

import dataclasses

import jax.numpy as jnp
import pytest

from hitl_jax.boundary.printed import PrintedLearner
from hitl_jax.config import AgentConfig
from hitl_jax.errors import InvalidValue
from hitl_jax.team.agent import make_agent


@dataclasses.dataclass(frozen=True)
class Halved(PrintedLearner):
    """Gives half of what ours gives."""

    def boundary(self, hyper, actor, observation):
        return 0.5 * super().boundary(hyper, actor, observation)


@dataclasses.dataclass(frozen=True)
class _Two(PrintedLearner):
    def boundary(self, hyper, actor, observation):
        return jnp.stack([super().boundary(hyper, actor, observation)] * 2)


@dataclasses.dataclass(frozen=True)
class _Forgets(PrintedLearner):
    def improve(self, hyper, state, batch):
        return super().improve(hyper, state, batch)[0]


@dataclasses.dataclass(frozen=True)
class _Raises(PrintedLearner):
    def draw(self, *given):
        raise KeyError("pool")


@dataclasses.dataclass(frozen=True)
class _Idle(PrintedLearner):
    num_updates = 0


def test_one_of_ones_own_is_taken():
    learner = Halved(24, (8,))
    agent = make_agent(AgentConfig(), boundary_learner=learner)
    assert agent.boundary_learner is learner


@pytest.mark.parametrize(
    ("kind", "said"),
    [
        (_Two, "must give one boundary"),
        (_Forgets, r"improve must give \(state, metrics\)"),
        (_Raises, "raised KeyError"),
        (_Idle, "num_updates 0: must be at least 1"),
    ],
)
def test_a_faulty_one_is_one_line(kind, said):
    with pytest.raises(InvalidValue, match=rf"^boundary_learner .*{said}") as error:
        make_agent(AgentConfig(), boundary_learner=kind(24, (8,)))
    assert "\n" not in str(error.value)
