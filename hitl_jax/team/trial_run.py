"""A team tried once before any work starts: a part that does not fit is one line that names it.

Each part is tried alone, then all that acts together; `team.trial_shapes` says how.
"""

import functools
from collections.abc import Mapping

import chex
import jax
import numpy as np

from hitl_jax.arbiter import FEEDBACK_SCHEDULES, Ruling, Situation, Takeover
from hitl_jax.boundary import Move
from hitl_jax.boundary.carry import first_carry, next_carry
from hitl_jax.config import RunHyper
from hitl_jax.errors import blamed_on
from hitl_jax.human import DANGER_MODELS, HUMAN_PARTS, HumanPart
from hitl_jax.human.caller_state import begun, form, kept
from hitl_jax.human.indicator import does_see_risk
from hitl_jax.team.acting import init_acting
from hitl_jax.team.packed_decision import act_or_begin
from hitl_jax.team.parts import Agent
from hitl_jax.team.trial_boundary import state_of_boundary_learner
from hitl_jax.team.trial_learning import state_of_learner, try_human_data
from hitl_jax.team.trial_shapes import Blamed, Given, given_of, many, sizes_of
from hitl_jax.types import Behavior
from hitl_jax.xla.pytree_words import pack, to_pieces


def require_runs(agent: Agent, names: Mapping[str, str]) -> None:
    """Tries a team.

    Args:
        agent: the team.
        names: what messages call its parts, by option; `judge` where the human is not the
            configuration's.

    Raises:
        InvalidValue: one line with the part and what is wrong with it.
    """
    _tried(agent, tuple(names.items()))


@functools.lru_cache(maxsize=8)
def _tried(agent: Agent, named: tuple[tuple[str, str], ...]) -> None:
    """Equal teams are tried once: it takes a fraction of a second."""
    names = dict(named)
    blamed = {name: Blamed(name, told) for name, told in names.items()}
    sizes = sizes_of(agent)
    given = given_of(sizes)
    _try_schedule(agent.config.feedback_schedule)
    seen = (given.seen, given.number) if does_see_risk(agent.indicator) else (given.seen,)
    number = blamed["indicator"].shapes(agent.indicator, *seen)
    blamed["indicator"].require(number, "one number")
    _try_human(agent, given, blamed)
    _try_hands(agent, given, blamed["human_actions"])
    _try_boundary_source(agent, given, blamed["boundary_source"])
    _try_release(agent, given, blamed["release"])
    _try_intervention(agent, given, blamed["intervention"])
    try_human_data(agent, given)
    learner = state_of_learner(agent.learner, sizes, names["learner"])
    boundary = state_of_boundary_learner(agent, given, blamed["boundary_learner"])
    risk = agent.risk_learner
    critic = None if risk is None else jax.eval_shape(risk.init, given.key).critic
    _try_together(agent, given, Behavior(learner.actor, boundary.actor, critic))


def _try_schedule(name: str) -> None:
    """The host asks it, with arrays of NumPy: of many runs, and of one episode."""
    schedule, blamed = FEEDBACK_SCHEDULES.make(name), Blamed("feedback_schedule", name)
    for shape in ((2, 3), (3,)):
        with blamed_on(*blamed):
            where = schedule(*(np.zeros(shape, bool) for _ in range(4)))
        blamed.require(where, "a truth value for each step", shape, real=False)


def _try_human(agent: Agent, given: Given, blamed: Mapping[str, Blamed]) -> None:
    config = agent.config
    if "judge" in blamed:
        _try_part(agent.human, given, blamed["judge"])
        return
    danger = DANGER_MODELS.make(config.danger)
    _try_part(danger, given, Blamed("danger", config.danger))
    for name in config.human_parts:
        _try_part(HUMAN_PARTS.make(name), given, Blamed("human_parts", name))


def _try_part(part: HumanPart, given: Given, blamed: Blamed) -> None:
    def live(
        hyper: RunHyper, seen: chex.Array, flag: chex.Array, key: chex.PRNGKey
    ) -> tuple[list[chex.Array], chex.Array]:
        first = begun("the human", part.init())
        state = kept("the human", part.begin_episode(first), first)
        after, dangerous = part.judge(state, hyper.human, seen, flag, key)
        after = kept("the human", part.notify(after, hyper.human, flag, flag), first)
        return to_pieces(after), dangerous

    _, dangerous = blamed.shapes(live, given.hyper, given.seen, given.flag, given.key)
    blamed.require(dangerous, "one truth value", real=False)


def _try_hands(agent: Agent, given: Given, blamed: Blamed) -> None:
    source, owner = agent.source, "the human's actions"

    def live(seen: chex.Array, key: chex.PRNGKey) -> tuple[list[chex.Array], chex.Array]:
        first = begun(owner, source.init())
        state = kept(owner, source.begin_episode(first), first)
        after, action = source.act(state, seen, key)
        return to_pieces(kept(owner, after, first)), action

    _, action = blamed.shapes(live, given.seen, given.key)
    blamed.require(action, f"{agent.config.action_size} actions", given.noise.shape)


def _try_boundary_source(agent: Agent, given: Given, blamed: Blamed) -> None:
    source = agent.boundary_source

    def live(
        hyper: RunHyper, number: chex.Array, flag: chex.Array
    ) -> tuple[chex.Array, chex.Array]:
        carry = first_carry(source, number)
        tau = source.boundary(carry, number)
        move = Move(
            boundary=number,
            following=number,
            alarmed=flag,
            control=flag,
            step=hyper.delta_plus,
            target_rate=hyper.target_rate,
            low=hyper.boundary_low,
            high=hyper.boundary_high,
            extra=hyper.extra,
        )
        return next_carry(source, carry, move), tau

    _, tau = blamed.shapes(live, given.hyper, given.number, given.flag)
    blamed.require(tau, "one number")


def _try_release(agent: Agent, given: Given, blamed: Blamed) -> None:
    def asked(hyper: RunHyper, number: chex.Array, flag: chex.Array) -> chex.Array:
        return agent.release(Takeover(flag, number, number, hyper.release_share, hyper.extra))

    goes_on = blamed.shapes(asked, given.hyper, given.number, given.flag)
    blamed.require(goes_on, "one truth value", real=False)


def _try_intervention(agent: Agent, given: Given, blamed: Blamed) -> None:
    def live(hyper: RunHyper, flag: chex.Array) -> tuple[list[chex.Array], Ruling]:
        state = begun("the intervention", agent.intervention.init())
        now = Situation(flag, flag, flag, hyper.takeover_steps, hyper.extra)
        after, ruling = agent.intervention.rule(state, now)
        return to_pieces(kept("the intervention", after, state)), ruling

    _, ruling = blamed.shapes(live, given.hyper, given.flag)
    if not isinstance(ruling, Ruling):
        raise blamed.refuse(f"must give (state, Ruling), gives {form(ruling)} for the Ruling")
    for name, value in vars(ruling).items():
        blamed.require(value, f"one truth value as {name}", real=False)


def _try_together(agent: Agent, given: Given, behavior: Behavior) -> None:
    """A tick of two runs: what each part can do alone may not go together, or not in a batch."""

    def tick(
        hyper: RunHyper,
        behavior: Behavior,
        seen: chex.Array,
        flag: chex.Array,
        key: chex.PRNGKey,
    ) -> tuple[chex.Array, chex.Array]:
        state = init_acting(agent, hyper, key)
        after, row = act_or_begin(agent, hyper, behavior, state, seen, flag)
        return pack(after), row

    runs = many((given.hyper, behavior, given.seen, given.flag, given.key))
    Blamed("team", "as a whole").shapes(jax.vmap(tick), *runs)
