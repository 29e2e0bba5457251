"""How often and how long should a human intervene? What each second in human hands brings.

One number of the human is changed at a time, and all else is the task's; beside them SRL has no
human at all. All settings are runs of one compiled program, in a store as ablations have it.
"""

from __future__ import annotations

import dataclasses
import pathlib
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from hitl_jax.analysis.figure_style import PAGE, attempt, line_mark, line_style, panels, save
from hitl_jax.choices.checks import one_of, require_seeds, require_whole
from hitl_jax.choices.fields import choice, described
from hitl_jax.config import Method
from hitl_jax.envs import WALKER
from hitl_jax.errors import InvalidValue
from hitl_jax.evaluation.trials import MOST_TEST_EPISODES
from hitl_jax.human import UNLIMITED
from hitl_jax.studies.ablations.human_time import GUIDE, draw_points, measured
from hitl_jax.studies.ablations.settings import Ablation, Budget, Setting
from hitl_jax.studies.ablations.store import Store
from hitl_jax.studies.ablations.write import lines_of
from hitl_jax.sweep.changes import Changes, changed, of_task
from hitl_jax.sweep.launchers import LaunchOptions
from hitl_jax.tasks import TASKS, task_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

NUMBERS = {
    "takeover_steps": "A takeover lasts at least [steps]",
    "rest": "Rest after a takeover, at least [steps]",
    "delay": "Reaction of the human [steps]",
    "interventions": "Interventions of a run, at most",
}
"""What is changed, each by itself, and how tables and figures call it."""
_OPTIONS = {
    "takeover_steps": "takeover_steps",
    "rest": "refractory_steps",
    "delay": "delay",
    "interventions": "max_interventions",
}
_BASE: Changes = {}
"""Of the task's defaults."""
_METHODS = (Method.HITL_AC, Method.HITL_FIX)
FIGURE = "study"


@described
@dataclasses.dataclass(frozen=True)
class StudyOptions:
    """How often and how long should a human intervene: return against the human's time.

    Each of four numbers takes its values in turn, while the others are the task's own. The task's
    own are run too, and SRL, which has no human.

    Attributes:
        env: the task:
        method: hitl-ac or hitl-fix.
        takeover_steps: least lengths of a takeover [steps].
        rest: rests that the human takes after a takeover [steps].
        delay: reaction delays of the human [steps].
        interventions: most interventions in a run.
        seeds: number of seeds for each setting.
        first_seed: the first of them.
        episodes: training episodes of a run.
        test_episodes: test episodes of a run, alone and again with the human.
        out: folder of the results: `runs.csv`, a table for each number, and `study.png`. What is
            there is not done again.
        launch: where runs are made.
    """

    env: str = choice(WALKER, TASKS)
    method: str = Method.HITL_AC
    takeover_steps: tuple[int, ...] = (25, 100, 200)
    rest: tuple[int, ...] = (100, 400)
    delay: tuple[int, ...] = (0, 20, 30)
    interventions: tuple[int, ...] = (50, 100)
    seeds: int = 5
    first_seed: int = 0
    episodes: int = 160
    test_episodes: int = 20
    out: str = "runs/study"
    launch: Annotated[LaunchOptions, tyro.conf.arg(name="")] = LaunchOptions()

    def checked(self) -> StudyOptions:
        """Checks every option; returns itself.

        Raises:
            InvalidValue: one line with the name, the value and what is allowed.
        """
        TASKS.check(self.env)
        one_of("method", self.method, _METHODS)
        require_seeds(self.first_seed, self.seeds)
        require_whole("episodes", self.episodes, at_least=1)
        require_whole("test_episodes", self.test_episodes, 1, MOST_TEST_EPISODES)
        if not any(getattr(self, name) for name in NUMBERS):
            why = "all four numbers have no values: nothing is to be studied"
            raise InvalidValue("takeover_steps", "(none)", why)
        for name in NUMBERS:
            values = getattr(self, name)
            if len(set(values)) < len(values):
                raise InvalidValue(name, " ".join(map(str, values)), "each at most once")
            for value in values:
                _require_allowed(self.env, name, value)
        self.launch.checked()
        return self

    def studied(self) -> dict[str, Ablation]:
        """What is run, by the number that is changed; equal settings of two are one run."""
        budget = Budget(self.seeds, self.first_seed, self.episodes, self.test_episodes)
        return {
            name: Ablation(title, self._settings(name), budget, base=_BASE, env=self.env)
            for name, title in NUMBERS.items()
            if getattr(self, name)
        }

    def _settings(self, name: str) -> tuple[Setting, ...]:
        methods = (Method(self.method),)
        own = _own_value(self.env, name)
        changed = [
            Setting(str(value), {_OPTIONS[name]: value}, methods)
            for value in getattr(self, name)
            if value != own
        ]
        usual = Setting(f"{_told(own)} (as the task has it)", {}, (Method.SRL, *methods))
        order = [*((float(each.label), each) for each in changed), (float(own), usual)]
        return tuple(each for _, each in sorted(order, key=lambda pair: pair[0]))


def _own_value(env: str, name: str) -> int:
    hyper = of_task(env, {}).hyper
    own: int = (vars(hyper) | vars(hyper.human))[_OPTIONS[name]]
    return own


def _told(value: int) -> str:
    return "unlimited" if value == UNLIMITED else str(value)


def _require_allowed(env: str, name: str, value: int) -> None:
    """Refuses a value that the option of a sweep would not have."""
    try:
        changed({_OPTIONS[name]: value})
    except ValueError as error:
        why = str(error).partition(": ")[2]
        raise InvalidValue(name, value, why) from error


def draw(options: StudyOptions, store: Store, path: pathlib.Path) -> list[str]:
    """Draws a panel for each number; the lines of what could not be drawn.

    Args:
        options: of the study.
        store: its runs.
        path: of the figure, without ending.
    """
    return attempt({FIGURE: lambda: save(_figure(options, store), path)}).failures


def _figure(options: StudyOptions, store: Store) -> Figure:
    studied = options.studied()
    columns = min(len(studied), 2)
    rows = -(-len(studied) // columns)
    figure, axes_of = panels(rows, columns, (PAGE * columns / 2, 0.8 + 2.7 * rows))
    rate = task_of(options.env).steps_per_second
    for axes, ablation in zip(axes_of, studied.values(), strict=False):
        lines = measured(lines_of(ablation, store))
        for method in Method:
            draw_points(axes, [line for line in lines if line.method == method], rate)
        axes.set_title(ablation.title, fontsize=9)
        axes.set(xlabel="in human hands during training [s]", ylabel="area under the tests")
    for spare in axes_of[len(studied) :]:
        spare.remove()
    marks: list[Any] = [
        line_mark(marker="o", label=f"{method.upper()}, {options.env}", **line_style(method))
        for method in (Method.SRL, Method(options.method))
    ]
    figure.legend(
        handles=marks,
        title=GUIDE,
        loc="outside lower center",
        handlelength=3.5,
    )
    return figure
