"""What a live session begins with."""

import dataclasses
from typing import NamedTuple

import chex
import jax
import numpy as np

from hitl_jax.config import Method, RunHyper
from hitl_jax.team import agent as agents
from hitl_jax.team.agent import Agent
from hitl_jax.team.parts import first_average
from hitl_jax.training.run_spec import LoopConfig
from hitl_jax.types import Params, TrainState


class SessionSetup(NamedTuple):
    """What a session begins with.

    Attributes:
        agent: the team; with a person, made with `person.judge` and `person.actions`.
        hyper: the run's hyperparameters, host scalars.
        loop: how much it learns.
        method: which method of the paper it runs.
        seed: of the run.
        with_person: whether a person judges.
        learns: whether it trains; otherwise a trained walker is tested.
        start: networks to begin with, as `checkpoint.networks_of` gives them; None is from scratch.
            They act from the first step on, and learn after the warm-up.
    """

    agent: Agent
    hyper: RunHyper
    loop: LoopConfig
    method: Method
    seed: int
    with_person: bool
    learns: bool
    start: dict[str, Params] | None = None

    def first_train(self, key: chex.PRNGKey) -> TrainState:
        """The training state at the start; with networks to begin with, it has fresh optimisers.

        Args:
            key: of the run's learning, [].

        Raises:
            ValueError: one line, if the networks are not this team's.
        """
        train = agents.init(self.agent, key)
        return train if self.start is None else _started(self.agent, train, self.start)


def _started(agent: Agent, train: TrainState, start: dict[str, Params]) -> TrainState:
    """A training state with networks that were learned before, and fresh optimisers."""
    learner, networks = train.learner, train.boundary
    mine = {
        "actor": learner.actor,
        "critic": learner.critic,
        "boundary_actor": networks.actor,
        "boundary_critic": networks.critic,
    }
    for name, tree in mine.items():
        if jax.tree.map(np.shape, tree) != jax.tree.map(np.shape, start.get(name)):
            raise ValueError(f"its {name} has other layers than this team's")
    learner = agent.learner.with_networks(learner, start["actor"], start["critic"])
    networks = dataclasses.replace(
        networks,
        actor=start["boundary_actor"],
        critic=start["boundary_critic"],
        target_critic=None if networks.target_critic is None else start["boundary_critic"],
    )
    risk = train.risk
    if risk is not None:
        risk = dataclasses.replace(risk, critic=start["risk"])
    average = first_average(agent.config, learner.actor)
    return dataclasses.replace(
        train, learner=learner, boundary=networks, risk=risk, average=average
    )
