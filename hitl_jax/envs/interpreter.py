"""`child_interpreter`: how to start a Python process that imports the same modules as this one."""

import os
import sys


def child_interpreter() -> tuple[list[str], dict[str, str]]:
    """The command and environment of an interpreter with this process's `sys.path`.

    Plain `python -m` looks into the current folder first, where a file of the user's may have the
    name of a module.

    Returns:
        The beginning of the command, and the environment variables.
    """
    folders = [entry or os.getcwd() for entry in sys.path if isinstance(entry, str)]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(folders)}
    return [sys.executable, "-P"], environment
