"""What logs in other tools' formats cost the loop."""

import pathlib
import tempfile
import time

from hitl_jax.benchmarks.loop import RUNS, specs_of, warm_up
from hitl_jax.config import AgentConfig, Method
from hitl_jax.envs import make_pool
from hitl_jax.results.episode_measures import Row
from hitl_jax.sweep.logs import LOGS, SweepLogs
from hitl_jax.sweep.logs.run_log import require_log
from hitl_jax.team.agent import make_agent
from hitl_jax.training.rollout import Rollout
from hitl_jax.training.run_spec import LoopConfig, num_slots

BAR = 0.02


def measure_logs(seconds: float) -> list[Row]:
    """The share of the loop's time that each log takes that is installed.

    Args:
        seconds: of play for each log, after its files are open.
    """
    agent = make_agent(AgentConfig())
    slots = num_slots(RUNS, RUNS)
    rows: list[Row] = []
    with make_pool("lean", slots) as pool, tempfile.TemporaryDirectory() as name:
        rollout = Rollout(agent, specs_of(list(Method), RUNS), pool, LoopConfig())
        chunks = iter(rollout)
        warm_up(rollout, chunks)
        for log in LOGS:
            try:
                require_log(log)
            except ImportError as error:
                rows.append({"log": f"{error}"})
                continue
            logs = SweepLogs([log], pathlib.Path(name), {}, print)
            begun = time.perf_counter()
            logs.follow(rollout.runs())  # All that came until now.
            opened = time.perf_counter() - begun
            start, before, spent = time.perf_counter(), _episodes(rollout), 0.0
            while time.perf_counter() - start < seconds:
                next(chunks)
                at = time.perf_counter()
                logs.follow(rollout.runs())
                spent += time.perf_counter() - at
            took, played = time.perf_counter() - start, _episodes(rollout) - before
            logs.close()
            rows.append(
                {
                    "log": log,
                    "runs": RUNS,
                    "begun s": round(opened, 2),
                    "episodes": played,
                    "ms an episode": round(1e3 * spent / max(played, 1), 2),
                    "share": round(spent / took, 4),
                    "bar": BAR,
                }
            )
    return rows


def _episodes(rollout: Rollout) -> int:
    return sum(len(run.episodes) for run in rollout.runs())
