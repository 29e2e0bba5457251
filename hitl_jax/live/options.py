"""The options of a live session."""

import dataclasses
from typing import Annotated, Any

import tyro

from hitl_jax.choices.checks import one_of, require, require_default
from hitl_jax.config import AgentConfig, Hyper, Method, validate_hyper
from hitl_jax.errors import InvalidValue
from hitl_jax.live.guide import CONSENT, GuideOptions
from hitl_jax.sweep.changes import Parts, changed
from hitl_jax.sweep.options import (
    require_hands,
    require_meaning,
    require_no_simulated_judge,
    require_room,
    require_team,
)
from hitl_jax.sweep.presets import PAPER
from hitl_jax.sweep.train_and_test import policy_digest
from hitl_jax.training.run_spec import LoopConfig

MODES = ("train", "test", "watch")
_HANDS = ("human_actions", "release")
_CONTROL = ("takeover_steps", "release_share")
"""What the simulated human does with the controls, and until when."""

_GUIDED = ("consent", "guided_steps")
"""Options of a guided session."""

_LONGEST = 2000
"""Of what a person agrees to [characters]."""

_LIVE = changed(PAPER | {"learner": AgentConfig().learner, "intervention": "takeover"})
"""A person looks at one boundary, which line 8 moves, and may take the controls."""


@dataclasses.dataclass(frozen=True)
class LiveOptions:
    """Watch a walker learn, and be its human, on a page in the browser.

    Attributes:
        mode: `train`, you are the human; `watch`, a simulated human is; `test`, a trained walker
            asks you for help where it crosses its boundary.
        start: a run's `params.npz` to begin with (default: from scratch; `test` needs one). The
            boundary begins where that of the run ended, if line 8 moved it; else at
            `initial_boundary`.
        method: `hitl-ac`, whose boundary is learned, or `hitl-fix`.
        seed: of the run.
        ask: whether the walker also stops and asks while it trains.
        answer_seconds: how long it waits for an answer [s]; then it goes on as if it were "safe".
        human_policy: a `params.npz` whose actor is the assistant (default: gymnasium's scripted
            walker), and the simulated human's hands (default: as `human_actions` says).
        guided: whether the page leads a person who has never seen it: through what to do, a line
            to agree to, and six questions at the end (NASA-TLX). `hitl-jax participants` makes one
            table of such sessions.
        guided_steps: how long a guided session is [steps]; 3000 are a minute of real time.
        consent: what a person agrees to before a guided session begins.
        port: of the page, on this machine; 0 takes any.
        open_page: whether to open the page in a browser.
        journal: where everything is noted. The same command goes on where it was; what was learned
            is beside it, with the ending .npz.
        agent: static choices.
        loop: how much the run learns.
        hyper: numbers.
    """

    mode: str = "train"
    start: str | None = None
    method: str = "hitl-ac"
    seed: int = 0
    ask: bool = False
    answer_seconds: float = 5.0
    human_policy: str | None = None
    guided: bool = False
    guided_steps: int = 15_000
    consent: str = CONSENT
    port: int = 8765
    open_page: bool = True
    journal: str = "runs/live/session.jsonl"
    agent: Annotated[AgentConfig, tyro.conf.arg(name="")] = _LIVE.agent
    loop: Annotated[LoopConfig, tyro.conf.arg(name="")] = LoopConfig()
    hyper: Annotated[Hyper, tyro.conf.arg(name="")] = _LIVE.hyper

    def checked(self) -> "LiveOptions":
        """Checks everything that can be checked before work starts; returns itself.

        Raises:
            InvalidValue: one line with the name, the value and what is allowed.
        """
        one_of("mode", self.mode, MODES)
        one_of("method", self.method, (str(Method.HITL_AC), str(Method.HITL_FIX)))
        require("seed", self.seed, at_least=0, at_most=2**32 - 1)
        require("answer_seconds", self.answer_seconds, at_least=0.1)
        require("port", self.port, at_least=0, at_most=65535)
        self._require_guide()
        validate_hyper(self.hyper)
        require_meaning(self.agent, self.hyper)
        require_team(self.agent, self.loop)
        require_room(self.agent, self.loop, slots=1)
        if self.mode == "test" and self.start is None:
            raise InvalidValue(
                "start", "(none)", "mode test needs a run's params.npz", mentions=("mode",)
            )
        # The others find a boundary as they act: there is none to show of the state that comes
        # next, nor one that a label could move afterwards.
        one_of("boundary_source", self.agent.boundary_source, ("rule",))
        one_of("feedback_schedule", self.agent.feedback_schedule, ("step",))
        if every := self.hyper.unattended_every:
            raise InvalidValue("unattended_every", every, "must be 0: somebody looks on")
        if self.with_person:
            self._require_nothing_simulated()
        else:
            require_hands(self.agent, _LIVE.agent, self.human_policy)
            if self.ask:
                raise InvalidValue(
                    "ask", True, "there is nobody to ask with mode watch", mentions=("mode",)
                )
        return self

    def _require_guide(self) -> None:
        require("guided_steps", self.guided_steps, at_least=1)
        if not self.guided:
            require_default(self, LiveOptions(), _GUIDED, "needs guided", mentions=("guided",))
            return
        if not self.with_person:
            raise InvalidValue(
                "guided", True, "there is nobody to guide with mode watch", mentions=("mode",)
            )
        if not self._agreed.isprintable() or not 0 < len(self._agreed) <= _LONGEST:
            why = f"must be a text of 1 to {_LONGEST} characters that can be printed"
            raise InvalidValue("consent", repr(self.consent)[:50], why)

    @property
    def guide(self) -> GuideOptions | None:
        """How a person is guided; None where nobody is."""
        if not self.guided:
            return None
        return GuideOptions(self._agreed, self.guided_steps, self.asks, self.answer_seconds)

    @property
    def asks(self) -> bool:
        """Whether the walker stops and asks where an alarm begins."""
        return self.ask or self.mode == "test"

    @property
    def _agreed(self) -> str:
        """On one line, since no file that this program reads has control characters in a text."""
        return " ".join(self.consent.split())

    def _require_nothing_simulated(self) -> None:
        """Refuses options of the simulated human, whom nobody would ask."""
        why = (
            "is of the simulated human; where you are the human (mode train, test) it has no "
            "meaning"
        )
        given = Parts(self.agent, self.loop, self.hyper, self.human_policy)
        require_no_simulated_judge(given, _LIVE, why, mentions=("mode",))
        require_default(self.agent, _LIVE.agent, _HANDS, why, mentions=("mode",))
        require_default(self.hyper, _LIVE.hyper, _CONTROL, why, mentions=("mode",))

    @property
    def with_person(self) -> bool:
        """Whether a person is the human."""
        return self.mode != "watch"

    def header(self) -> dict[str, Any]:
        """What defines the session's numbers; a journal begins with it."""
        return {
            "mode": self.mode,
            "method": self.method,
            "seed": self.seed,
            "start": policy_digest(self.start, name="start"),
            "human_policy": policy_digest(self.human_policy),
            "agent": dataclasses.asdict(self.agent),
            "loop": dataclasses.asdict(self.loop),
            "hyper": dataclasses.asdict(self.hyper),
        }
