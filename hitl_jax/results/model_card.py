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
    env, agent = config.get("task", {}).get("env", "BipedalWalker-v3"), config.get("agent", {})
    alone, helped = (select(tests, "mode", mode) for mode in ("autonomous", "assisted"))
    rows = {
        "task": env,
        "learner": agent.get("learner", "unknown"),
        "training": f"{len(episodes['episode'])} episodes, {info['env_steps']:,} steps",
    }
    if key.method != "srl":
        names = ("danger", "intervention", "human_actions")
        chosen = [agent.get(name, "unknown") for name in names]
        rows["simulated human"] = "danger {}, intervention {}, hands {}".format(*chosen)
        share = episodes["human_steps"].sum() / max(int(episodes["length"].sum()), 1)
        rows["in human hands"] = f"{share:.1%} of the training steps"
    rows["tested alone"] = _tested(alone)
    if len(helped["return"]):
        rows["tested with the human"] = _tested(helped)
    rows["code"] = f"commit {info['commit'] or 'unknown'}"
    table = "\n".join(f"| {name} | {value} |" for name, value in rows.items())
    lost = "Its numbers turned not finite in training: it is of no use.\n\n"
    diverged = lost if info.get("diverged") else ""
    return (
        f"{_head(key.method, env, alone)}# {key.method.upper()}, seed {key.seed}, on {env}\n\n"
        "A policy that hitl_jax trained (human-in-the-loop actor-critic). "
        f"{_WHAT.get(key.method, '')}\n\n| | |\n| --- | --- |\n{table}\n\n{diverged}{_USE}"
    )


_USE = """\
```python
from hitl_jax import load_run

policy = load_run("the folder of this file, inside of its results")
action = policy(observation)  # In [-1, 1].
```

One seed of an experiment: the results folder has the others, and what may be concluded from all. It
was trained and tested in simulation alone; no person took part.
"""


def _tested(table: Table) -> str:
    returns = table["return"]
    if not len(returns):
        return "not"
    told = f"return {returns.mean():.1f} ± {returns.std():.1f} over {len(returns)} episodes"
    return f"{told}, {table['fall'].mean():.0%} with a fall"


def _head(method: str, env: str, alone: Table) -> str:
    """YAML, as https://huggingface.co/docs/hub/model-cards has it; JSON's strings are YAML's."""
    tags = json.dumps(["reinforcement-learning", "human-in-the-loop", env])
    head = {
        "library_name": "hitl_jax",
        "pipeline_tag": "reinforcement-learning",
        "tags": tags,
    }
    if len(alone["return"]):
        result = {
            "task": {"type": "reinforcement-learning"},
            "dataset": {"name": env, "type": env},
            "metrics": [{"type": "mean_reward", "value": round(float(alone["return"].mean()), 2)}],
        }
        head["model-index"] = json.dumps([{"name": method, "results": [result]}])
    lines = "".join(f"{name}: {value}\n" for name, value in head.items())
    return f"---\n{lines}---\n\n"
