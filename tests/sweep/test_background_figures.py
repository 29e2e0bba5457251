"""Figures that are drawn while a sweep runs."""

import subprocess
import sys

from hitl_jax.results.atomic_files import TEMPORARY
from hitl_jax.sweep.background_figures import BackgroundFigures


def test_a_drawing_that_is_ended_leaves_no_temporary_file(tmp_path):
    figures = BackgroundFigures(tmp_path, lambda: None)
    folder = tmp_path / "figures"
    folder.mkdir()
    (folder / "figure4_training.png").write_bytes(b"whole")
    (folder / f"{TEMPORARY}{'0' * 16}").write_bytes(b"ha")  # Of a drawing in mid-write.
    figures._drawing = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"])
    figures.stop()
    assert figures._drawing.poll() is not None
    assert [path.name for path in folder.iterdir()] == ["figure4_training.png"]
