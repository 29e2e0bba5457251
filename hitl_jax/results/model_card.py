"""A model card for a finished run: `README.md` in its folder, with the head that hubs read."""

import json
from collections.abc import Mapping
from typing import Any

from hitl_jax.results.episode_tables import Table, select
from hitl_jax.results.run_key import RunKey

FILE = "README.md"
"""In a run's folder. Nothing reads it again."""

_WHAT = {
    "srl": "It learned alone, by reinforcement.",
    "hitl-fix": "A human intervened in training, called where the safety indicator reached a fixed "
    "boundary.",
    "hitl-ac": "A human intervened in training, called where the safety indicator reached a "
    "boundary that an actor-critic learned beside it.",
}


def model_card(key: RunKey, info: Mapping[str, Any], episodes: Table, tests: Table) -> str:
    """The card, as Markdown.

    Args:
        key: method and seed.
        info: of run.json.
        episodes: of training.
        tests: at the end.
    """
    config = info["config"]
    backend, agent = config.get("backend", "lean"), config.get("agent", {})
    own = f"walkers of {backend}" if ":" in backend else "BipedalWalker-v3"
    env = config.get("task", {}).get("env", own)
    alone, helped = (select(tests, "mode", mode) for mode in ("autonomous", "assisted"))
    rows = {
        "task": env,
        "learner": agent.get("learner", "unknown"),
        "training": f"{len(episodes['episode'])} episodes, {info['env_steps']:,} steps",
    }
    if key.method != "srl":
        rows["human"] = _human(config, agent)
        share = episodes["human_steps"].sum() / max(int(episodes["length"].sum()), 1)
        rows["in human hands"] = f"{share:.1%} of the training steps"
    rows["tested alone"] = _tested(alone)
    if len(helped["return"]):
        rows["tested with the human"] = _tested(helped)
    rows["code"] = f"commit {info['commit'] or 'unknown'}"
    table = "\n".join(f"| {name} | {value} |" for name, value in rows.items())
    lost = "Its numbers turned not finite in training: it is of no use.\n\n"
    lost = lost if info.get("diverged") else ""
    head = _head(key.method, env, alone, bool(lost))
    return (
        f"{head}# {key.method.upper()}, seed {key.seed}, on {env}\n\n"
        "A policy that hitl_jax trained (human-in-the-loop actor-critic). "
        f"{_WHAT.get(key.method, '')}\n\n| | |\n| --- | --- |\n{table}\n\n{lost}{_USE}"
    )


_USE = """\
```python
from hitl_jax import load_run

policy = load_run("the folder of this file, inside of its results")
action = policy(observation)  # In [-1, 1].
```

One seed of an experiment: the results folder has the others, and what may be concluded from all. It
was trained and tested in simulation alone.
"""


def _human(config: Mapping[str, Any], agent: Mapping[str, Any]) -> str:
    intervention = f"intervention {agent.get('intervention', 'unknown')}"
    if config.get("human"):
        judges = "a person's recorded judgements"
    elif config.get("fitted_human"):
        judges = "a model that was fitted to a person, or to another human"
    else:
        judges = f"simulated, danger {agent.get('danger', 'unknown')}"
    hands = f"hands {agent.get('human_actions', 'unknown')}"
    if config.get("human_policy"):
        hands = "hands of a policy that was given"
    elif config.get("fitted_human"):
        hands = f"{hands}, or those of the model"
    return f"{judges}; {intervention}, {hands}"


def _tested(table: Table) -> str:
    returns = table["return"]
    if not len(returns):
        return "not"
    told = f"return {returns.mean():.1f} ± {returns.std():.1f} over {len(returns)} episodes"
    return f"{told}, {table['fall'].mean():.0%} with a fall"


def _head(method: str, env: str, alone: Table, diverged: bool) -> str:
    """YAML, as https://huggingface.co/docs/hub/model-cards has it; JSON's strings are YAML's."""
    tags = json.dumps(["reinforcement-learning", "human-in-the-loop", env])
    head = {
        "library_name": "hitl_jax",
        "pipeline_tag": "reinforcement-learning",
        "tags": tags,
    }
    if len(alone["return"]) and not diverged:
        result = {
            "task": {"type": "reinforcement-learning"},
            "dataset": {"name": env, "type": env},
            "metrics": [{"type": "mean_reward", "value": round(float(alone["return"].mean()), 2)}],
        }
        head["model-index"] = json.dumps([{"name": method, "results": [result]}])
    lines = "".join(f"{name}: {value}\n" for name, value in head.items())
    return f"---\n{lines}---\n\n"
