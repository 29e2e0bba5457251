"""Walkers of a results folder as they were when training ended."""

from typing import Any

from hitl_jax import checkpoint
from hitl_jax.agent import Agent
from hitl_jax.commands import judgements
from hitl_jax.commands.training import make_team, policy_digest
from hitl_jax.config import AgentConfig, Hyper, Method, hyper_for
from hitl_jax.files import ResultsError
from hitl_jax.human import HumanParams
from hitl_jax.results import ResultsFolder
from hitl_jax.run_key import RunKey, sort_keys
from hitl_jax.runs import RunSpec, Snapshot
from hitl_jax.types import Behavior


def agent_of(folder: ResultsFolder, human_policy: str | None = None) -> Agent:
    """The team that was trained.

    Args:
        folder: the results.
        human_policy: the `params.npz` that gave the human's actions; None is the scripted walker.

    Raises:
        ResultsError: if the folder was not written by this program.
        ValueError: if the file is no such checkpoint.
    """
    choices = _section(folder, "agent")
    lists = {name: tuple(value) for name, value in choices.items() if isinstance(value, list)}
    try:
        config = AgentConfig(**choices | lists)
    except (TypeError, ValueError) as error:
        raise ResultsError(f"{folder.path}: config.json: {error}") from error
    return make_team(config, human_policy, judgements.kept(folder.path))


def require_same_human(folder: ResultsFolder, human_policy: str | None) -> None:
    """Refuses another source of the human's actions than the results were made with.

    Raises:
        ValueError: one line naming the option.
    """
    asked, has = policy_digest(human_policy), folder.load_config().get("human_policy")
    if asked != has:
        raise ValueError(
            f"--human-policy {human_policy}: {folder.path} was made with "
            f"{'the scripted walker' if has is None else f'a file of {has}'}"
        )


def able_to_play(folder: ResultsFolder) -> list[RunKey]:
    """The finished runs less those that diverged, which are named in a printed line.

    Raises:
        ResultsError: if a run is damaged.
    """
    keys = sort_keys(folder.finished())
    lost = [key for key in keys if folder.load_run(key).diverged]
    if lost:
        print(f"diverged, left out: {', '.join(map(str, lost))}", flush=True)
    return [key for key in keys if key not in lost]


def load_trained(folder: ResultsFolder, key: RunKey) -> tuple[RunSpec, Snapshot]:
    """A finished run and what acts at its end.

    Raises:
        ResultsError: if the run is not there, or is not of this program.
    """
    numbers = _section(folder, "hyper")
    try:
        hyper = Hyper(**numbers | {"human": HumanParams(**numbers["human"])})
        params = checkpoint.unflatten(folder.load_params(key))
        acts = Behavior(actor=params["actor"], boundary_actor=params["boundary_actor"])
        method = Method(key.method)
        spec = RunSpec(method, key.seed, hyper_for(method, hyper), folder.load_config()["episodes"])
        return spec, Snapshot(spec.episodes, acts, params["boundary"])
    except (TypeError, ValueError, KeyError) as error:
        raise ResultsError(f"{folder.path}: {key}: {error}") from error


def _section(folder: ResultsFolder, name: str) -> dict[str, Any]:
    section = folder.load_config().get(name)
    if not isinstance(section, dict):
        raise ResultsError(f"{folder.path}: config.json has no {name!r}: not of a sweep")
    return section
