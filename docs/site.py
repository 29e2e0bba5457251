"""Hook of mkdocs: lays out the site as the repository is, so that links hold in both."""

import pathlib
import re
import shutil
import tempfile
from typing import Any

_ROOT = pathlib.Path(__file__).parents[1]
_PAGES = (
    *("README.md", "SECURITY.md", "CHANGELOG.md", "results/README.md", "results/REPORT.md"),
    *("hitl_jax/human/trained_human.md", "hitl_jax/tasks/humans/README.md"),
)
_NOTEBOOK = pathlib.Path("docs/first_steps.ipynb")
_LINK = re.compile(r"\]\(([^)#\s]+)")
_REFERENCE = (
    *("hitl_jax.team.acting", "hitl_jax.team.agent", "hitl_jax.config", "hitl_jax.types"),
    *("hitl_jax.boundary", "hitl_jax.boundary.margin", "hitl_jax.boundary.losses"),
    *("hitl_jax.arbiter", "hitl_jax.arbiter.interventions", "hitl_jax.arbiter.feedback"),
    *("hitl_jax.learner.losses", "hitl_jax.learner.replay", "hitl_jax.learner.task_learner"),
    *("hitl_jax.human.part", "hitl_jax.human.parts", "hitl_jax.human.danger"),
    *("hitl_jax.human.actions", "hitl_jax.human.indicator", "hitl_jax.risk.learner"),
    *("hitl_jax.tasks.task", "hitl_jax.envs", "hitl_jax.envs.base", "hitl_jax.envs.gymnasium_env"),
    *("hitl_jax.training.rollout", "hitl_jax.training.run_spec", "hitl_jax.walker.env"),
    *("hitl_jax.playback.trained_run", "hitl_jax.results.all_runs", "hitl_jax.results.folder"),
    *("hitl_jax.sweep.logs.run_log", "hitl_jax.choices.registry", "hitl_jax.choices.options"),
)
"""Modules whose docstrings are the reference."""


_STAGE = pathlib.Path(tempfile.mkdtemp(prefix="hitl_jax-site-"))


def on_config(config: Any) -> Any:
    """Copies the pages, and the pictures and files that they show, into a folder of their own.

    Args:
        config: of mkdocs.
    """
    stage = _STAGE
    docs = [path.relative_to(_ROOT) for path in sorted((_ROOT / "docs").glob("*.md"))]
    _copy(stage, _NOTEBOOK)
    for page in [*map(pathlib.Path, _PAGES), *docs]:
        _copy(stage, page)
        for link in _LINK.findall((_ROOT / page).read_text()):
            target = (_ROOT / page.parent / link).resolve()
            if target.is_file() and target.is_relative_to(_ROOT):
                _copy(stage, target.relative_to(_ROOT))
    parts = [f"::: {module}\n" for module in _REFERENCE]
    (stage / "reference.md").write_text("# Reference\n\n" + "\n".join(parts))
    config["docs_dir"] = str(stage)
    return config


def on_post_page(output: str, page: Any, config: Any) -> str:
    """Lets the notebook's links to pages hold, which mkdocs does not see.

    Args:
        output: the page as HTML.
        page: its file and title.
        config: of mkdocs.
    """
    del config
    if not page.file.src_uri.endswith(".ipynb"):
        return output
    return re.sub(r'href="([\w-]+)\.md"', r'href="../\1/"', output)


def on_shutdown() -> None:
    """Removes that folder."""
    shutil.rmtree(_STAGE)


def _copy(stage: pathlib.Path, path: pathlib.Path) -> None:
    (stage / path).parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(_ROOT / path, stage / path)
