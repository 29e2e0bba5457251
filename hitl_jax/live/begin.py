"""How a session begins: with networks from files, or where a journal says that it was."""

import pathlib
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from hitl_jax.config import Method, RunHyper, hyper_for
from hitl_jax.errors import InvalidValue, ResultsError
from hitl_jax.evaluation.trials import frozen
from hitl_jax.human import actions
from hitl_jax.learner.networks import Actor
from hitl_jax.live import journal, person
from hitl_jax.live.options import LiveOptions
from hitl_jax.live.session import Session
from hitl_jax.live.setup import SessionSetup
from hitl_jax.results.config_diff import changes, compared
from hitl_jax.results.provenance import origin
from hitl_jax.team import agent as agents
from hitl_jax.team import checkpoint
from hitl_jax.team.agent import Agent, make_agent, require_extra
from hitl_jax.xla.threefry import make_key


def setup_of(options: LiveOptions) -> SessionSetup:
    """What a session begins with.

    Raises:
        ValueError: one line, if a file is not what it should be, or a number is of no choice.
    """
    config = options.agent
    assistant = None
    if options.human_policy is not None:
        actor = checkpoint.load_actor(
            options.human_policy, config.observation_size, config.action_size
        )
        *hidden, size = checkpoint.hidden_sizes(actor)
        assistant = actions.policy(Actor(tuple(hidden), size).apply, actor)
    hyper = hyper_for(Method(options.method), options.hyper)
    if options.mode == "test":
        hyper = frozen(hyper, human_present=True)
    if options.with_person:
        hands = person.actions(config.action_size, assistant)
        agent = make_agent(config, judge=person.judge(), source=hands)
    else:
        agent = make_agent(config, source=assistant)
    require_extra(agent, options.hyper)
    return SessionSetup(
        agent=agent,
        hyper=hyper,
        loop=options.loop,
        method=Method(options.method),
        seed=options.seed,
        with_person=options.with_person,
        learns=options.mode != "test",
        start=None if options.start is None else networks_from(options.start, agent, hyper),
    )


def networks_from(path: str, agent: Agent, hyper: RunHyper) -> dict[str, Any]:
    """The networks that a session begins with.

    A run of another boundary learner, such as a sweep's default, gives its task networks alone. The
    boundary then begins as at the start of a run: `rule` executes neither learner's networks.

    Raises:
        InvalidValue: one line, if the file is not what it should be.
    """
    try:
        arrays = checkpoint.load(path)
        fresh = checkpoint.flatten(
            agents.init(agent, make_key(0)), np.asarray(hyper.initial_boundary, np.float32)
        )
        has, needs = _boundary_shapes(arrays), _boundary_shapes(fresh)
        if has and has != needs:
            kept = {name: array for name, array in arrays.items() if name not in has}
            arrays = kept | {name: fresh[name] for name in (*needs, "boundary")}
        networks = checkpoint.networks_of(agent, arrays)
        boundary = float(networks["boundary"])
        low, high = float(hyper.boundary_low), float(hyper.boundary_high)
        if not low <= boundary <= high:
            raise ValueError(
                f"its boundary {boundary:g}: must be at least {low:g} and at most {high:g}"
            )
    except ValueError as error:
        raise InvalidValue("start", path, str(error)) from error
    return networks


def _boundary_shapes(arrays: Mapping[str, np.ndarray]) -> dict[str, tuple[int, ...]]:
    """Of the boundary's networks, by name."""
    return {
        name: array.shape
        for name, array in arrays.items()
        if name.startswith(("boundary_actor/", "boundary_critic/"))
    }


def lines_of(
    path: pathlib.Path, header: dict[str, Any], say: Callable[[str], None]
) -> list[journal.Line]:
    """What was noted before, if the session is the same.

    Args:
        path: of the journal.
        header: `LiveOptions.header` of the session that is asked for.
        say: is told if it was begun with other versions.

    Raises:
        ResultsError: naming the first difference.
    """
    before, lines = journal.read(path)
    if line := differences(path, before):
        say(line)
    if differs := first_difference(before, header):
        name, has, asked = differs
        raise ResultsError(
            f"{path}: its session has {name} {has}, asked for {asked}: name another journal"
        )
    return lines


def first_difference(one: journal.Line, other: journal.Line) -> tuple[str, str, str] | None:
    """Where the sessions of two headers differ: the option, and both values; None if nowhere."""

    def told(header: journal.Line) -> dict[str, Any]:
        kept = {name: value for name, value in header.items() if name not in ("journal", "made")}
        return _flat(compared(kept))

    first, second, nothing = told(one), told(other), object()
    for name in second | first:
        if first.get(name, nothing) != second.get(name, nothing):
            return name[:50], str(first.get(name))[:50], str(second.get(name))[:50]
    return None


def differences(path: pathlib.Path, header: dict[str, Any]) -> str:
    """One line if a session was begun with other versions, or on another processor; else empty."""
    changed = changes(header.get("made", {}), origin())
    return f"{path} was begun with {'; '.join(changed)}" if changed else ""


def go_on(
    session: Session, lines: list[journal.Line], path: pathlib.Path, say: Callable[[str], None]
) -> None:
    """Plays what was noted again.

    Args:
        session: at its beginning.
        lines: of the journal.
        path: of the journal.
        say: is told now and then how far it is.

    Raises:
        ResultsError: if it does not come out as it was noted.
    """
    last = lines[-1]["at"] if lines else 0
    for frame in journal.play(session, lines, path):
        if frame % 3200 == 0 or frame == last:
            say(f"played again {frame:,} of {last:,} frames")


def _flat(tree: Any, name: str = "") -> dict[str, Any]:
    if not isinstance(tree, dict):
        return {name: list(tree) if isinstance(tree, tuple) else tree}
    parts = (_flat(value, f"{name}.{key}" if name else key) for key, value in tree.items())
    return {key: value for part in parts for key, value in part.items()}
