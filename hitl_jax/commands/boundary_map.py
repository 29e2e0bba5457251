"""The boundary as a function of the state: `hitl-jax boundary-map RESULTS`.

For results whose boundary an actor gives (`--boundary-source network` or `residual`). Plays
HITL-AC's trained walkers alone, and shows the mean boundary over hull angle and angular velocity
where they have been.
"""

import contextlib
import dataclasses
import pathlib

import numpy as np
import tyro

from hitl_jax.analysis.figure_style import COLUMN, GREY, Drawn, attempt, panels, save
from hitl_jax.analysis.figures import boundary_label, tolerance_in
from hitl_jax.choices.checks import require
from hitl_jax.config import Method
from hitl_jax.console.cli import checking_input, print_drawn
from hitl_jax.envs import make_pool
from hitl_jax.errors import BadInput, ResultsError
from hitl_jax.evaluation.host import Evaluator, evaluate_policies
from hitl_jax.playback.episodes import playing_backend
from hitl_jax.playback.load_trained import able_to_play, agent_of, load_trained
from hitl_jax.results.atomic_files import named_errors, read_bytes, write_text_atomic
from hitl_jax.results.episode_tables import numbers_from_csv
from hitl_jax.results.folder import ResultsFolder
from hitl_jax.results.run_key import RunKey
from hitl_jax.sweep.compile_cache import keep_programs
from hitl_jax.team.agent import Agent

DATA = "boundary_map.csv"
"""In a results folder."""

_COLUMNS = ("angle", "velocity", "steps", "boundary")
_SOURCES = ("network", "residual")
_VELOCITY_UNIT = 25.0  # rad/s; the observation is 2 ω / 50
_ANGLES = np.linspace(-1.0, 1.0, 41)  # edges of cells [rad]
_VELOCITIES = np.linspace(-5.0, 5.0, 41)  # [rad/s]
_NAME = "figure9_map"
_FEW = 3
"""Steps in a cell below which its mean says nothing."""


@dataclasses.dataclass(frozen=True)
class MapOptions:
    """Maps the boundary that an actor has learned; writes RESULTS/boundary_map.csv and figure 9.

    Attributes:
        results: a folder that a sweep has written, with `network` or `residual` as its source.
        episodes: test episodes of a run.
    """

    results: tyro.conf.Positional[pathlib.Path]
    episodes: int = 20


def main(options: MapOptions) -> int:
    """Plays, writes and draws.

    Args:
        options: what to play.

    Returns:
        The exit code: 0, or 1 if the figure could not be drawn.

    Raises:
        BadInput: where there is nothing to map.
    """
    with checking_input():
        require("episodes", options.episodes, at_least=1)
    try:
        folder = ResultsFolder(options.results)
        agent = agent_of(folder)
        source = agent.config.boundary_source
        if source not in _SOURCES:
            raise BadInput(
                f"{options.results}: its boundary source is {source}: must be one of "
                f"{', '.join(_SOURCES)}, where an actor's output is executed"
            )
        keys = [key for key in able_to_play(folder) if key.method == Method.HITL_AC]
        if not keys:
            raise BadInput(f"{options.results}: no run of HITL-AC has finished yet")
        keep_programs()
        steps = np.zeros((_ANGLES.size - 1, _VELOCITIES.size - 1))
        sums = np.zeros_like(steps)
        with contextlib.closing(make_pool(playing_backend(folder), options.episodes)) as pool:
            evaluator = Evaluator(agent, pool)
            for key in keys:
                visited = _visits(agent, evaluator, folder, key)
                cells = (visited[:, 0], visited[:, 1])
                edges = (_ANGLES, _VELOCITIES)
                steps += np.histogram2d(*cells, bins=edges)[0]
                sums += np.histogram2d(*cells, bins=edges, weights=visited[:, 2])[0]
                print(f"{key}: {len(visited):,} steps", flush=True)
        write_text_atomic(options.results / DATA, _to_csv(steps, sums))
        drawn = draw(folder)
    except ResultsError as error:
        raise BadInput(str(error)) from error
    return print_drawn(drawn)


def draw(folder: ResultsFolder) -> Drawn:
    """Draws the figure into the folder's `figures`.

    Raises:
        ResultsError: if the data are damaged.
    """
    with named_errors(folder.path / DATA):
        angle, velocity, _, boundary = _cells(folder)
        edges = (_ANGLES, _VELOCITIES)
        sums, counts = (
            np.histogram2d(angle, velocity, bins=edges, weights=weights)[0]
            for weights in (boundary, None)
        )
    mean = np.where(counts > 0, sums / np.maximum(counts, 1), np.nan)

    def make() -> list[pathlib.Path]:
        figure, [axes] = panels(1, 1, (COLUMN, 3.6))
        mesh = axes.pcolormesh(_ANGLES, _VELOCITIES, mean.T, cmap="viridis", rasterized=True)
        figure.colorbar(mesh, label=boundary_label(folder))
        title = "white: not visited"
        tolerance = tolerance_in(folder)
        if tolerance is not None:
            title = f"dashed: the human's tolerance; {title}"
            for side in (-tolerance, tolerance):
                axes.axvline(side, color=GREY, linewidth=0.9, linestyle="--")
        axes.set(xlabel="hull angle [rad]", ylabel="hull angular velocity [rad/s]")
        axes.set_title(title, fontsize=8.0)
        return save(figure, folder.path / "figures" / _NAME)

    return attempt({_NAME: make})


def told(folder: ResultsFolder) -> tuple[np.ndarray, np.ndarray]:
    """Steps in each cell of the map, and the mean boundary there, [C] each.

    Raises:
        ResultsError: if the data are damaged.
    """
    with named_errors(folder.path / DATA):
        _, _, steps, boundary = _cells(folder)
        return steps, boundary


def _cells(folder: ResultsFolder) -> list[np.ndarray]:
    """The columns of the data, [C] each."""
    data = numbers_from_csv(read_bytes(folder.path / DATA).decode(), _COLUMNS)
    angles, velocities, steps, boundary = data.values()
    if not steps.size:
        raise ValueError("has no cell")
    if (steps < 1).any() or (steps != np.floor(steps)).any():
        raise ValueError("steps: must be whole numbers of at least 1")
    for name, values, edges in (("angle", angles, _ANGLES), ("velocity", velocities, _VELOCITIES)):
        if ((values < edges[0]) | (values > edges[-1])).any():
            raise ValueError(f"{name}: must be from {edges[0]:g} to {edges[-1]:g}")
    return [angles, velocities, steps, boundary]


def _visits(agent: Agent, evaluator: Evaluator, folder: ResultsFolder, key: RunKey) -> np.ndarray:
    """Hull angle, angular velocity and boundary of every step of the tests, [T, 3]."""
    spec, end = load_trained(agent, folder, key)
    layout = agent.layout
    visited: list[np.ndarray] = []

    def watch(decided: np.ndarray, active: np.ndarray) -> None:
        angle, velocity = decided[active, layout.observation][:, :2].T
        boundary = decided[active, layout.boundary]
        visited.append(np.column_stack([angle, velocity * _VELOCITY_UNIT, boundary]))

    evaluate_policies(evaluator, "autonomous", spec, [end], watch)
    return np.concatenate(visited)


def _to_csv(steps: np.ndarray, sums: np.ndarray) -> str:
    lines = [",".join(_COLUMNS) + "\n"]
    for angle, velocity in np.argwhere(steps >= _FEW):
        middle = (_ANGLES[angle : angle + 2].mean(), _VELOCITIES[velocity : velocity + 2].mean())
        count = steps[angle, velocity]
        mean = sums[angle, velocity] / count
        lines.append(f"{middle[0]:.6f},{middle[1]:.6f},{count:.0f},{mean:.6f}\n")
    return "".join(lines)
