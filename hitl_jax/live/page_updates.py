"""The messages that show a session on a page; the page's script reads them."""

from typing import Any, NamedTuple

from hitl_jax.envs.visible_walker import FEET, LIDAR, shapes
from hitl_jax.human.indicator import INDICATORS, unit_of
from hitl_jax.live.guide import GuideOptions
from hitl_jax.live.session import Session
from hitl_jax.results.episode_measures import Row

PageUpdate = dict[str, Any]
"""`type`, and the fields of that type."""

_ENDS = {"human-reset": "human", "time-limit": "time limit"}


class PageOptions(NamedTuple):
    """How a session is shown.

    Attributes:
        mode: `train`, `test` or `watch`.
        title: of the page.
        asks: whether the walker stops and asks where an alarm begins.
        answer_seconds: how long it waits for an answer; then it goes on, which counts as safe.
        silence_seconds: how long a person's page may leave frames unanswered; after that, nobody
            is there.
        guide: whether and how a person is guided.
    """

    mode: str
    title: str
    asks: bool
    answer_seconds: float
    silence_seconds: float = 1.0
    guide: GuideOptions | None = None


def hello(session: Session, options: PageOptions) -> PageUpdate:
    """What stays the same while a page is open."""
    config = session.setup.agent.config
    return {
        "type": "hello",
        "mode": options.mode,
        "title": options.title,
        "indicator": config.indicator if config.indicator in INDICATORS else "indicator",
        "unit": unit_of(config.indicator) or "1",
        "span": 1.0,
        "intervention": config.intervention,
        "answer_seconds": options.answer_seconds,
        "asks": options.asks,
        "guide": options.guide and options.guide._asdict(),
        "no_answer": "Without an answer it counts as safe, and the walker goes on.",
        **shapes(),
    }


def history(session: Session) -> PageUpdate:
    """All episodes that have ended."""
    return {"type": "history", "episodes": [_shown(row) for row in session.episodes]}


def episode(row: Row) -> PageUpdate:
    """An episode that has just ended."""
    return {"type": "episode", **_shown(row)}


def terrain(session: Session) -> PageUpdate:
    """The ground of the episode."""
    return {"type": "terrain", "episode": session.frame.episode, **session.walker.terrain()}


def frame(session: Session) -> PageUpdate:
    """The state that comes next."""
    now, person = session.frame, session.person
    watched = not session.setup.with_person
    before = max(now.number - 1, 0)
    simulated = watched and session.flag("control", before)
    dangerous = session.flag("dangerous", before) if watched else person.dangerous
    control = "person" if person.in_control else "human" if simulated else "machine"
    return {
        "type": "frame",
        "n": now.number,
        "episode": now.episode,
        "step": now.step,
        "bodies": session.walker.bodies(),
        "lidar": [round(float(share), 4) for share in now.observation[LIDAR]],
        "feet": [bool(now.observation[foot]) for foot in FEET],
        "c": round(now.indicator, 4),
        "tau": round(now.boundary, 4) if session.setup.hyper.has_arbiter else None,
        "alarm": now.alarmed,
        "danger": dangerous,
        "control": control,
        "return": round(session.returned, 2),
        "interventions": session.interventions,
        "steps": session.env_steps,
    }


def status(session: Session, pace: dict[str, Any]) -> PageUpdate:
    """Where the session stands, beside the frame.

    Args:
        session: the session.
        pace: further fields, of `PacedSession`.
    """
    person = session.person
    said = [label for label in person.labels if label.cause is None and label.kind != "nobody"]
    return {
        "type": "status",
        **pace,
        "labels": len(said),
        "learner": f"{session.updates:,} updates",
        "danger_held": person.dangerous and not person.in_control,
    }


def _shown(row: Row) -> dict[str, Any]:
    """What a page shows of an episode."""
    return {
        "episode": row["episode"],
        "return": round(row["return"], 2),
        "boundary": round(row["final_boundary"], 4),
        "interventions": row["interventions"],
        "length": row["length"],
        "end": _ENDS.get(row["end"], row["end"]),
    }
