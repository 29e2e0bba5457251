"""Figure 9: the boundary as a function of the state, where an actor gives it."""

import pathlib

import numpy as np

from hitl_jax.analysis.figure_data import boundary_label, tolerance_in
from hitl_jax.analysis.figure_style import COLUMN, GREY, Drawn, attempt, panels, save
from hitl_jax.results.atomic_files import named_errors, read_bytes, write_text_atomic
from hitl_jax.results.episode_tables import numbers_from_csv
from hitl_jax.results.folder import ResultsFolder

DATA = "boundary_map.csv"
"""In a results folder."""

_COLUMNS = ("angle", "velocity", "steps", "boundary")
_ANGLES = np.linspace(-1.0, 1.0, 41)  # edges of cells [rad]
_VELOCITIES = np.linspace(-5.0, 5.0, 41)  # [rad/s]
_NAME = "figure9_map"
_FEW = 3
"""Steps in a cell below which its mean says nothing."""


class Cells:
    """Steps and boundaries, counted by hull angle and angular velocity."""

    def __init__(self) -> None:
        self._steps = np.zeros((_ANGLES.size - 1, _VELOCITIES.size - 1))
        self._sums = np.zeros_like(self._steps)

    def add(self, visited: np.ndarray) -> None:
        """Counts steps: hull angle [rad], angular velocity [rad/s] and boundary [rad], [T, 3]."""
        cells, edges = (visited[:, 0], visited[:, 1]), (_ANGLES, _VELOCITIES)
        self._steps += np.histogram2d(*cells, bins=edges)[0]
        self._sums += np.histogram2d(*cells, bins=edges, weights=visited[:, 2])[0]

    def write(self, folder: ResultsFolder) -> None:
        """Writes the data of the figure.

        Raises:
            ResultsError: if the disk refuses.
        """
        write_text_atomic(folder.path / DATA, _to_csv(self._steps, self._sums))


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


def _to_csv(steps: np.ndarray, sums: np.ndarray) -> str:
    lines = [",".join(_COLUMNS) + "\n"]
    for angle, velocity in np.argwhere(steps >= _FEW):
        middle = (_ANGLES[angle : angle + 2].mean(), _VELOCITIES[velocity : velocity + 2].mean())
        count = steps[angle, velocity]
        mean = sums[angle, velocity] / count
        lines.append(f"{middle[0]:.6f},{middle[1]:.6f},{count:.0f},{mean:.6f}\n")
    return "".join(lines)
