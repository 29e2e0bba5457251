"""The figure of what learners were at."""

import numpy as np
import pytest
from example_figures import INFO, make_tests
from example_training import make_training

from hitl_jax.analysis import diagnostic_figure
from hitl_jax.results.run_key import RunKey

_UPDATES = (3200, 6400, 9600)
"""Of samples, where a chunk has more than a thousand updates."""


def _save(folder, seed, values, updates=_UPDATES):
    rows = [
        {"updates": count, "env_steps": count, "episodes": 1, "q": value, "never": np.nan}
        for count, value in zip(updates, values, strict=True)
    ]
    info = INFO | {"wall_seconds": 1.0, "env_steps": 1}
    made = make_training("hitl-ac", seed), make_tests("hitl-ac"), {}, info
    folder.save_run(RunKey("hitl-ac", seed), *made, diagnostics=rows)


@pytest.fixture
def drawn(folder, monkeypatch):
    """Draws, and gives the figure."""
    figures = []
    monkeypatch.setattr(diagnostic_figure, "save", lambda figure, path: figures.append(figure))

    def draw():
        assert diagnostic_figure.draw(folder).failures == []
        return figures[-1]

    return draw


def test_samples_stand_where_they_were_taken(folder, drawn):
    _save(folder, 0, (1.0, 2.0, 3.0))
    _save(folder, 1, (3.0, np.inf, 5.0))  # One sample of a run does not take the others with it.
    panels = {panel.get_title(): panel for panel in drawn().axes}
    assert set(panels) == {"q", "never"}
    [line] = panels["q"].get_lines()
    assert line.get_xdata().tolist() == [3.2, 6.4, 9.6]
    np.testing.assert_array_equal(line.get_ydata(), [2.0, np.nan, 4.0])
    assert not panels["never"].get_lines()
    assert panels["q"].get_xlabel() == "thousands of updates"


def test_runs_without_a_sample_have_no_figure(folder):
    _save(folder, 0, (), ())
    [file] = folder.path.glob("runs/*/*/diagnostics.csv")
    assert file.read_text() == "updates,env_steps,episodes\n"
    [line] = diagnostic_figure.draw(folder).lines
    assert line == "figure10_diagnostics: no data for it"
