"""What a human's help is worth to trained walkers, at any rate of alarms and by any rule for them.

Each walker is tested alone and then, on the same terrains, with the human, whom four rules call:
the run's own boundary π_θ(s) moved by a constant; a fixed boundary on the run's own indicator; one
on the hull's angle; and chance. Each rule is set to raise alarms at given shares of the steps of
the autonomous test, so that the rules can be compared at equal human time. Each calls two humans:
the run's own, who judges whether the state is dangerous, and one who trusts every alarm, so that
the rule alone decides.
"""

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import chex
import jax
import jax.numpy as jnp
import numpy as np

from hitl_jax.analysis.assistance_figure import ALONE, COLUMNS, DATA, JUDGES, NOBODY, TRUSTS
from hitl_jax.arbiter import RELEASES
from hitl_jax.boundary import SOURCES
from hitl_jax.config import Method, RunHyper, traced
from hitl_jax.envs import WalkerPool
from hitl_jax.errors import ResultsError
from hitl_jax.evaluation.host import HostExaminer
from hitl_jax.evaluation.trials import terrain_seeds, trial_key
from hitl_jax.human.indicator import INDICATORS, WALKER_OBSERVATION
from hitl_jax.human.trusting import trusting
from hitl_jax.playback.episodes import playing_pool
from hitl_jax.playback.load_trained import able_to_play, load_trained
from hitl_jax.results.atomic_files import write_text_atomic
from hitl_jax.results.episode_measures import Row
from hitl_jax.results.episode_tables import rows_to_csv
from hitl_jax.results.folder import ResultsFolder
from hitl_jax.team.agent import Agent
from hitl_jax.training.run_spec import RunSpec, Snapshot
from hitl_jax.types import Behavior

SHARES = (0.0005, 0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)
"""Of the steps of an autonomous test that have an alarm."""

_NO_BOUND = 1e6
"""Above every indicator."""


class _Rule(NamedTuple):
    """Who calls the human.

    Attributes:
        name: in the table.
        agent: the team with this rule; the carry of its boundary source is the constant.
        score: maps what acts, the run's hyperparameters and an observation [O] to what must reach
            the constant for an alarm, [].
        bounded: whether the run's bounds hold for the boundary.
    """

    name: str
    agent: Agent
    score: Callable[[Behavior, RunHyper, chex.Array], chex.Array]
    bounded: bool = False


def write_assistance(
    folder: ResultsFolder, agent: Agent, episodes: int, say: Callable[[str], None]
) -> None:
    """Tests the trained walkers of HITL-FIX and HITL-AC with the human, and writes the table.

    Args:
        folder: of a sweep.
        agent: its team.
        episodes: test episodes of a run at each rate of alarms.
        say: is told of each run.

    Raises:
        ResultsError: one line, where there is nothing to play.
    """
    keys = [key for key in able_to_play(folder, say) if key.method != Method.SRL]
    if not keys:
        raise ResultsError(f"{folder.path}: no run with a human has finished yet")
    rows: list[dict[str, Any]] = []
    with playing_pool(folder, agent, episodes * len(SHARES)) as pool:
        tests = {method: _Tests(agent, pool, method) for method in {key.method for key in keys}}
        for number, key in enumerate(keys, start=1):
            spec, end = load_trained(agent, folder, key)
            run = {"method": key.method, "seed": key.seed}
            rows += [run | row for row in tests[key.method].rows(spec, end, episodes)]
            say(f"{number}/{len(keys)} {key}")
    write_text_atomic(folder.path / DATA, rows_to_csv(rows, COLUMNS))


class _Tests:
    """The tests of a method's walkers, alone and by each rule."""

    def __init__(self, agent: Agent, pool: WalkerPool, method: str):
        self._layout = agent.layout
        self._rules = _rules(agent, method)
        self._alone = HostExaminer(agent, pool)
        self._assisted = [
            (rule, human, HostExaminer(rule.agent._replace(human=part), pool))
            for rule in self._rules
            for human, part in ((JUDGES, agent.human), (TRUSTS, trusting(agent.human)))
        ]
        scores = {rule.name: rule.score for rule in self._rules}

        def tell(acts: Behavior, hyper: RunHyper, seen: jax.Array) -> dict[str, jax.Array]:
            return {name: score(acts, hyper, seen) for name, score in scores.items()}

        self._tell = jax.jit(jax.vmap(tell, in_axes=(None, None, 0)))

    def rows(self, spec: RunSpec, end: Snapshot, episodes: int) -> list[dict[str, Any]]:
        """A row for the walker alone, and one for each rule, human and rate of alarms."""
        key, seeds = trial_key(spec), terrain_seeds(spec, range(episodes))
        told: list[dict[str, np.ndarray]] = []

        def watch(decided: np.ndarray, active: np.ndarray) -> None:
            seen = self._tell(end.behavior, spec.hyper, decided[:, self._layout.observation])
            told.append({name: score[active] for name, score in jax.device_get(seen).items()})

        def stacked(tree: Any, count: int) -> Any:
            return jax.tree.map(lambda leaf: np.repeat(np.asarray(leaf)[None], count, 0), tree)

        acts, carry = stacked(end.behavior, 1), stacked(end.boundary, 1)
        played = self._alone.evaluate(
            "autonomous", spec.hyper, acts, carry, key, seeds[None], watch
        )
        alone = {"rule": ALONE, "human": NOBODY, "alarm_share": 0.0, "constant": 0.0}
        rows = [alone | _sums(played)]
        acts = stacked(end.behavior, len(SHARES))
        for rule, human, examiner in self._assisted:
            score = np.concatenate([step[rule.name] for step in told])
            constants = np.quantile(score, 1.0 - np.array(SHARES)).astype(np.float32)
            hyper, all_seeds = _hyper(spec.hyper, rule), np.tile(seeds, (len(SHARES), 1))
            played = examiner.evaluate("assisted", hyper, acts, constants, key, all_seeds)
            rows += [
                {"rule": rule.name, "human": human}
                | {"alarm_share": share, "constant": float(constant)}
                | _sums(played[place * episodes : (place + 1) * episodes])
                for place, (share, constant) in enumerate(zip(SHARES, constants, strict=True))
            ]
        return rows


def _sums(tests: Sequence[Row]) -> dict[str, Any]:
    """What the table holds of some test episodes."""
    return {
        "episodes": len(tests),
        "return_mean": float(np.mean([row["return"] for row in tests])),
        **{name: sum(row[of] for row in tests) for name, of in _SUMS.items()},
    }


_SUMS = {
    "falls": "fall",
    "steps": "length",
    "human_steps": "human_steps",
    "interventions": "interventions",
}


def _rules(agent: Agent, method: str) -> list[_Rule]:
    """Who calls the human of a method's walkers; the run's own boundary comes first.

    By all of them a takeover ends as the human judges: a rule's own indicator decides nothing else.
    """
    agent = agent._replace(release=RELEASES.make("judgement"))
    fixed = agent._replace(boundary_source=SOURCES.make("rule"))

    def size(of: Agent, acts: Behavior, hyper: RunHyper, seen: chex.Array) -> chex.Array:
        del hyper
        return jnp.abs(of.safety_indicator(acts, seen))

    def margin(acts: Behavior, hyper: RunHyper, seen: chex.Array) -> chex.Array:
        boundary = agent.boundary_learner.boundary(traced(hyper), acts.boundary_actor, seen)
        reached = size(agent, acts, hyper, seen)
        # Wherever it is moved, the boundary stays within the run's bounds.
        above = jnp.where(reached >= hyper.boundary_high, _NO_BOUND, reached - boundary)
        return jnp.where(reached < hyper.boundary_low, -_NO_BOUND, above)

    rules = [_Rule("fixed boundary", fixed, functools.partial(size, agent))]
    if method == Method.HITL_AC and agent.executes_actor:
        moved = agent._replace(boundary_source=SOURCES.make("residual"))
        rules.insert(0, _Rule("learned boundary", moved, margin, bounded=True))
    others = {"chance": fixed._replace(indicator=_chance)}
    config = agent.config
    if config.indicator != "hull_angle" and config.observation_size == WALKER_OBSERVATION:
        angle = fixed._replace(indicator=INDICATORS.make("hull_angle"))
        others = {"hull angle": angle} | others
    return rules + [
        _Rule(name, other, functools.partial(size, other)) for name, other in others.items()
    ]


def _hyper(hyper: RunHyper, rule: _Rule) -> RunHyper:
    """A run's hyperparameters under a rule, whose constant is executed in HITL-FIX too."""
    hyper = dataclasses.replace(hyper, learns_boundary=1.0)
    if rule.bounded:
        return hyper
    return dataclasses.replace(hyper, boundary_low=0.0, boundary_high=_NO_BOUND)


def _chance(observation: chex.Array) -> chex.Array:
    """A number of 0 to 1 that nothing can be told from, the same for the same observation."""
    bits = jnp.sum(jax.lax.bitcast_convert_type(observation, jnp.uint32))
    return jax.random.uniform(jax.random.key(bits))
