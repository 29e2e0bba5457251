"""Starting another Python process of ours."""

import os
import sys


def child_interpreter() -> tuple[list[str], dict[str, str]]:
    """How to start an interpreter that finds the modules that this process finds (`sys.path`).

    Without it `python -m` looks into the current folder first, where a file of the user's may have
    the name of a module that is imported.

    Returns:
        The beginning of the command, and the environment.
    """
    folders = [entry or os.getcwd() for entry in sys.path if isinstance(entry, str)]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(folders)}
    return [sys.executable, "-P"], environment
