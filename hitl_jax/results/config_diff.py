"""How what a results folder was made with differs from what is asked for."""

import json
import pathlib
from typing import Any

from hitl_jax.errors import ResultsError
from hitl_jax.results.provenance import short_commit

_MAX_DIFFERENCES = 5
_LONGEST = 100
_THEN = ", then "
_LEARNER, _PARTS = "agent.boundary_learner", "agent.margin_parts"

_SHOWN = ("solved", "steps_per_second")
"""Of a task: what figures and tables say of it, and no run depends on."""

CAME_LATER: dict[str, dict[str, Any]] = {
    "agent": {
        "matmul_precision": "float32",
        "human_parts": ["delay", "mistakes", "lapses", "attention"],
        "human_actions": "scripted",
        "human_data": "transitions",
        "tested_actor": "last",
        "boundary_learner": "printed",
        "margin_parts": [
            *("heavy_tails", "often", "two_critics", "targets"),
            *("half_alarms", "takeovers", "line_8", "noise_told", "sees_indicator", "judgement"),
        ],
        "risk_hidden_sizes": [64, 64],
        "risk_batch_size": 64,
        "risk_horizon": 50,
    },
    "hyper": {
        "human": {"extra": {}},
        "extra": {},
        "average_step_size": 0.001,
        "risk_learning_rate": 3e-4,
        "unattended_every": 0,
        "noise_steps": 0,
        "final_noise": 0.0,
        "human_price": 0.0,
        "reward_weight": 1.0,
        "boundary_temperature": 0.0,
    },
}
"""Choices added since results were kept, by section, and the value that changes nothing."""


class ConfigMismatch(ResultsError):
    """A results folder that was made with another config."""


def flatten(tree: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """A nested dict as one level, with dots in the keys; an empty dict is a value."""
    flat: dict[str, Any] = {}
    for name, value in tree.items():
        if isinstance(value, dict) and value:
            flat |= flatten(value, f"{prefix}{name}.")
        else:
            flat[prefix + name] = value
    return flat


def completed(config: dict[str, Any]) -> dict[str, Any]:
    """A config that an earlier commit may have written, with the choices that came later."""
    whole = dict(config)
    for section, choices in CAME_LATER.items():
        has = config.get(section)
        if isinstance(has, dict):
            whole[section] = _with(has, choices)
    agent = config.get("agent")
    if isinstance(agent, dict):
        parts, learner = CAME_LATER["agent"]["margin_parts"], agent.get("boundary_learner")
        if learner == "margin":
            later = "noise_told", "sees_indicator", "judgement"
            parts = [part for part in parts if part not in later]
        whole["agent"]["margin_parts"] = agent.get("margin_parts", parts)
    return whole


def compared(config: dict[str, Any]) -> dict[str, Any]:
    """A config, completed, without the choices that mean nothing in it: what is compared."""
    whole = completed(config)
    task = whole.get("task")
    if isinstance(task, dict):
        whole["task"] = {name: task[name] for name in task if name not in _SHOWN}
    agent = whole.get("agent")
    if isinstance(agent, dict) and agent["boundary_learner"] == "printed":
        whole["agent"] = {name: agent[name] for name in agent if name != "margin_parts"}
    return whole


def _with(section: dict[str, Any], choices: dict[str, Any]) -> dict[str, Any]:
    whole = dict(section)
    for name, value in choices.items():
        has = section.get(name)
        if not (value and isinstance(value, dict)):
            whole.setdefault(name, value)
        elif isinstance(has, dict):
            whole[name] = _with(has, value)
    return whole


def without_later(section: dict[str, Any], choices: dict[str, Any]) -> dict[str, Any]:
    """A section as it was written before there were choices that change nothing in it.

    Args:
        section: of a config.
        choices: of `CAME_LATER`, the section's.
    """
    left = {}
    for name, value in section.items():
        later = choices.get(name)
        if later and isinstance(later, dict):
            left[name] = without_later(value, later)
        elif name not in choices or (list(value) if isinstance(value, tuple) else value) != later:
            left[name] = value
    return left


def require_same(path: pathlib.Path, has: dict[str, Any], asked: dict[str, Any]) -> None:
    """Makes sure that a folder was made with what is asked for.

    A choice that came later, and that one of them lacks, is taken as its default.

    Args:
        path: the folder.
        has: what it was made with, a nested dict of what JSON can hold.
        asked: what is asked for.

    Raises:
        ConfigMismatch: naming the first differences.
    """
    old, new, nothing = flatten(compared(has)), flatten(compared(asked)), object()
    keys = [k for k in old | new if old.get(k, nothing) != new.get(k, nothing)]
    if old.get(_LEARNER) != new.get(_LEARNER):  # Then one of them may lack the parts.
        keys = [k for k in keys if k != _PARTS or (k in old and k in new)]
    if not keys:
        return
    lines = [
        f"{k[:_LONGEST]}: folder has {_shown(old, k)}, asked for {_shown(new, k)}"
        for k in sorted(keys)
    ]
    more = [f"and {len(lines) - _MAX_DIFFERENCES} more"] * (len(lines) > _MAX_DIFFERENCES)
    shown = "; ".join(lines[:_MAX_DIFFERENCES] + more)
    raise ConfigMismatch(f"{path}: made with another config: {shown}")


def _shown(values: dict[str, Any], name: str) -> str:
    return json.dumps(values[name])[:_LONGEST] if name in values else "nothing"


def changes(made: dict[str, Any], now: dict[str, Any]) -> list[str]:
    """Differences between what made something and what is here now, a few words each.

    Args:
        made: `versions` by package, `commit` and `processor`; what it lacks is not compared.
        now: likewise, nothing lacking that `made` has.
    """
    old, new = _named(made), _named(now)
    return [
        f"{name} {value or 'unknown'}, now {new.get(name) or 'none'}"
        for name, value in old.items()
        if value != new.get(name)
    ]


def joined(earlier: dict[str, str], now: dict[str, str]) -> dict[str, str]:
    """Versions of what was made in several sittings, by package: all of them, in their order."""
    if not earlier:
        return now
    whole = {}
    for name in earlier | now:
        before, value = earlier.get(name, "none"), now.get(name, "none")
        whole[name] = before if before.split(_THEN)[-1] == value else before + _THEN + value
    return whole


def _named(source: dict[str, Any]) -> dict[str, Any]:
    """Commit, processor and versions on one level."""
    named = {name: source[name] for name in ("commit", "processor") if name in source}
    if "commit" in named:
        named["commit"] = short_commit(named["commit"])
    return named | source.get("versions", {})
