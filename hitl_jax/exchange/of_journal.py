"""The episodes of a live session, played again from its journal."""

import pathlib
from collections.abc import Iterator
from typing import Any

import numpy as np

from hitl_jax.envs import WALKER
from hitl_jax.exchange.played import Played, Source
from hitl_jax.live import journal
from hitl_jax.live.labels import judged, unjudged
from hitl_jax.live.recorded_person import setup_again
from hitl_jax.live.session import Session
from hitl_jax.training.run_spec import episode_seed

_FLAGS = ("terminated", "truncated", "alarmed", "human_action")


def of_journal(path: pathlib.Path, start: str | None, human_policy: str | None) -> Source:
    """All episodes of a session in which a person judged; the last may be unfinished.

    Args:
        path: of the journal.
        start: the `params.npz` that the session began with, if it began with one.
        human_policy: the `params.npz` of its assistant, if it had one.

    Raises:
        ResultsError: one line, if it is no such journal, or does not come out as it was noted.
        ValueError: one line, if the files are others.
    """
    header, lines = journal.read(path)
    setup = setup_again(path, header, start, human_policy)
    return Source(WALKER, "a person's session", _played(Session(setup), lines, path))


def _played(session: Session, lines: list[journal.Line], path: pathlib.Path) -> Iterator[Played]:
    frames: list[Any] = []
    taken: list[tuple[Any, ...]] = []

    def take() -> None:
        """Notes the step that was played last, while it is still kept."""
        if frames:
            number = frames[-1].number
            [action] = session.actions(number, number + 1)
            flags = [session.flag(name, number) for name in _FLAGS]
            taken.append((action, session.env_reward(number), *flags))

    def note() -> None:
        take()
        frames.append(session.frame)

    for _ in journal.play(session, lines, path, before_step=note):
        pass
    take()
    frames.append(session.frame)
    dangerous = judged(session.labels, 0, len(taken))
    watched = ~unjudged(session.labels, 0, len(taken))
    setup = session.setup
    phase = setup.method if setup.learns else "test"
    begins = [n for n, frame in enumerate(frames[:-1]) if frame.step == 0 and not frame.ended]
    for index, first in enumerate(begins):
        stop = first
        while stop < len(taken) and not frames[stop].ended:
            stop += 1
        action, reward, terminated, truncated, alarmed, human = (
            np.array(column) for column in zip(*taken[first:stop], strict=True)
        )
        cut = truncated.astype(bool)
        cut[-1] |= not terminated[-1]  # Time, the person, or the end of the session.
        steps = slice(first, stop)
        yield Played(
            name=f"{path.name} episode {index + 1}",
            seed=episode_seed(phase, setup.seed, index),
            observations=np.array([frame.observation for frame in frames[first : stop + 1]]),
            actions=action.astype(np.float32),
            rewards=reward.astype(np.float32),
            terminated=terminated.astype(bool),
            truncated=cut,
            boundary=np.array([frame.boundary for frame in frames[steps]], np.float32),
            alarmed=alarmed.astype(bool),
            dangerous=dangerous[steps],
            human_action=human.astype(bool),
            judged=watched[steps],
        )
