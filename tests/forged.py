"""JSON files that were changed on purpose, with the digest of what they hold now."""

import json
import pathlib
from collections.abc import Callable
from typing import Any

from hitl_jax.results.json_documents import to_json


def rewrite(path: pathlib.Path, change: Callable[[dict[str, Any]], Any]) -> None:
    """Changes a document, and signs it anew."""
    document = json.loads(path.read_text())
    document.pop("digest", None)
    change(document)
    path.write_text(to_json(document))


def as_of_format_1(run: pathlib.Path) -> None:
    """Writes the run.json of a run as it was before it had digests."""
    path = run / "run.json"
    document = json.loads(path.read_text()) | {"format": 1}
    path.write_text(json.dumps({k: v for k, v in document.items() if k not in ("digest", "files")}))


def of_config(folder: pathlib.Path, change: Callable[[dict[str, Any]], Any]) -> None:
    """Changes the config of a folder and of its runs alike."""
    for path in (folder / "config.json", *folder.glob("runs/*/*/run.json")):
        rewrite(path, lambda document: change(document["config"]))
