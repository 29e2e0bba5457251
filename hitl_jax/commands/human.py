"""Makes a trained human of a task, as come with the package: `hitl-jax human`.

Trains a crew of walkers that stumble, and fits what a human expects of a pose to what came of
theirs: `experience.npz`. Then it trains walkers that learn to go on from there, and writes the best
of these: `hands.npz` (`hitl_jax.studies.trained_human`). It takes about an hour on
two cores; what is interrupted begins again.
"""

import dataclasses
import pathlib
import time

from hitl_jax.choices.checks import require_whole
from hitl_jax.choices.fields import choice, described
from hitl_jax.console.cli import BadInput, checking_input
from hitl_jax.console.output import say
from hitl_jax.envs import WALKER, host_backend, require_backend
from hitl_jax.human import experience, shipped_network
from hitl_jax.human.trained_walker import FILE, PREFIX
from hitl_jax.results.atomic_files import write_bytes_atomic
from hitl_jax.studies import trained_human as study
from hitl_jax.sweep.compile_cache import keep_programs
from hitl_jax.tasks import TASKS, task_of
from hitl_jax.training.rollout import Rollout

_SECONDS = 60.0
"""Between two lines of progress."""


@described
@dataclasses.dataclass(frozen=True)
class HumanOptions:
    """Train a human who foresees falls, and whose hands can walk on.

    Attributes:
        env: the task:
        crew_episodes: training episodes of each walker of `ddpg` that stumbles; of `td3-tqc` half
            as many.
        episodes: training episodes of each that learns to go on.
        test_episodes: of each.
        out: folder of the files, made if need be.
    """

    env: str = choice(WALKER, TASKS)
    crew_episodes: int = 500
    episodes: int = 1200
    test_episodes: int = 50
    out: str = "runs/human"


def main(options: HumanOptions) -> int:
    """Trains, chooses and writes.

    Args:
        options: how much is trained, and where the file goes.

    Returns:
        The exit code.

    Raises:
        BadInput: for options that are not allowed.
    """
    out = pathlib.Path(options.out)
    with checking_input():
        require_whole("crew_episodes", options.crew_episodes, at_least=16)
        require_whole("episodes", options.episodes, at_least=1)
        require_whole("test_episodes", options.test_episodes, at_least=1)
        TASKS.check(options.env)
        task = task_of(options.env)
        require_backend(host_backend(task.env_id), task.env_id)
        base = study.base_of(options.env)
        try:
            out.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise BadInput(f"--out {options.out}: {error.strerror}") from error
    keep_programs()
    tests = options.test_episodes
    crew = study.train_crew(base, options.crew_episodes, tests, _Progress("crew"))
    expects = study.gain_experience(base, crew, tests, say)
    data = shipped_network.to_npz(expects, experience.PREFIX)
    write_bytes_atomic(out / experience.FILE, data)
    trained = study.train_hands(base, crew, expects, options.episodes, tests, _Progress("hands"))
    for one in trained:
        alone, with_crew = (study.mean_return(one, mode) for mode in ("autonomous", "assisted"))
        say(f"seed {one.key.seed}: test {alone:.1f} alone, {with_crew:.1f} with the crew")
    best = study.best_hands(trained)
    actor = best.finished.kept.learner.actor
    path = out / FILE
    write_bytes_atomic(path, shipped_network.to_npz(actor, PREFIX))
    say(f"{out / experience.FILE}\n{path}: seed {best.key.seed}")
    return 0


class _Progress:
    """Says now and then how far a batch is."""

    def __init__(self, name: str):
        self._name, self._due = name, time.monotonic() + _SECONDS

    def __call__(self, rollout: Rollout) -> None:
        if time.monotonic() < self._due:
            return
        self._due = time.monotonic() + _SECONDS
        runs = rollout.runs()
        left = sum(run.spec.episodes - len(run.episodes) for run in runs)
        say(f"{self._name}: {left} episodes left of this batch")
