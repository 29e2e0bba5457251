"""Walkers of a results folder as they were when training ended."""

from collections.abc import Callable
from typing import TypeVar

from hitl_jax.choices.registry import require_trusted
from hitl_jax.config import AgentConfig, Hyper, Method, hyper_for, validate_hyper
from hitl_jax.errors import InvalidValue, ResultsError
from hitl_jax.results.atomic_files import named_errors
from hitl_jax.results.folder import ResultsFolder
from hitl_jax.results.json_documents import options_of
from hitl_jax.results.run_key import RunKey, sort_keys
from hitl_jax.sweep import fitted_human, recorded_human
from hitl_jax.sweep.train_and_test import make_team, policy_digest
from hitl_jax.team import checkpoint
from hitl_jax.team.agent import Agent
from hitl_jax.training.run_spec import RunSpec, Snapshot
from hitl_jax.types import Behavior

T = TypeVar("T")


def agent_of(folder: ResultsFolder, human_policy: str | None = None) -> Agent:
    """The team that was trained.

    Args:
        folder: the results.
        human_policy: the `params.npz` that gave the human's actions; None: as `human_actions` says.

    Raises:
        ResultsError: if the folder was not written by this program, or names code, the walkers'
            included, that is not trusted.
        ValueError: if the file is no such checkpoint.
    """
    config = section_of(folder, "agent", AgentConfig)
    made = folder.load_config()
    places = {"backend": made.get("backend"), "env": made.get("task", {}).get("env")}
    require_trusted(folder.path / "config.json", vars(config) | places)
    fitted = fitted_human.load_from_results(folder)
    if fitted is not None:
        return make_team(config, human_policy, fitted.judge, fitted.source)
    return make_team(config, human_policy, recorded_human.load_from_results(folder))


def require_same_human(folder: ResultsFolder, human_policy: str | None) -> None:
    """Refuses another source of the human's actions than the results were made with.

    Raises:
        InvalidValue: in one line.
    """
    asked, has = policy_digest(human_policy), folder.load_config().get("human_policy")
    if asked != has:
        made = "the hands that its human_actions names" if has is None else f"a file of {has}"
        raise InvalidValue("human_policy", human_policy, f"{folder.path} was made with {made}")


def able_to_play(folder: ResultsFolder, say: Callable[[str], None]) -> list[RunKey]:
    """The finished runs less those that diverged, of which `say` is told.

    Raises:
        ResultsError: if a run is damaged.
    """
    keys = sort_keys(folder.finished())
    lost = [key for key in keys if folder.load_run(key).diverged]
    if lost:
        say(f"diverged, left out: {', '.join(map(str, lost))}")
    return [key for key in keys if key not in lost]


def load_trained(agent: Agent, folder: ResultsFolder, key: RunKey) -> tuple[RunSpec, Snapshot]:
    """A finished run and what acts at its end.

    Args:
        agent: the team of `agent_of`.
        folder: the results.
        key: the run.

    Raises:
        ResultsError: if the run is not there, or is not of this program.
    """
    hyper = section_of(folder, "hyper", Hyper)
    arrays = folder.load_params(key)
    with named_errors(folder.path):
        validate_hyper(hyper)
        method = Method(key.method)
    with named_errors(folder.run_path(key) / "params.npz"):
        params = checkpoint.networks_of(agent, arrays)
    acts = Behavior(params["actor"], params["boundary_actor"], params.get("risk"))
    spec = RunSpec(method, key.seed, hyper_for(method, hyper), folder.load_config()["episodes"])
    return spec, Snapshot(spec.episodes, acts, params["boundary"])


def section_of(folder: ResultsFolder, name: str, kind: type[T]) -> T:
    """A part of config.json as the options that it was written from.

    Raises:
        ResultsError: if it is not there, or no such options.
    """
    config = folder.load_config()
    section = config.get(name)
    for has, what in ((isinstance(section, dict), name), ("episodes" in config, "episodes")):
        if not has:
            raise ResultsError(f"{folder.path}: config.json has no {what!r}: not of a sweep")
    with named_errors(folder.path / "config.json"):
        return options_of(section, kind)
