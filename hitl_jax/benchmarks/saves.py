"""What saving the runs under way costs, and how long it takes to go on with them."""

import pathlib
import tempfile
import time

from hitl_jax.benchmarks.loop import RUNS, specs_of, warm_up
from hitl_jax.config import AgentConfig, Method
from hitl_jax.envs import make_pool
from hitl_jax.results.episode_measures import Row
from hitl_jax.sweep.options import SweepOptions
from hitl_jax.team.agent import make_agent
from hitl_jax.training.rollout import Rollout
from hitl_jax.training.run_spec import LoopConfig, num_slots
from hitl_jax.training.saved_run_store import Saves

BAR = 0.03
_STRETCHES = 2  # the first save has all frames of the warm-up in it


def measure_saves(seconds: float) -> list[Row]:
    """A save after every stretch of play as long as a sweep's, then a start from the last one.

    Args:
        seconds: of a stretch, as a share of 2 s of a sweep's: 2.0 plays what a sweep plays between
            two saves.
    """
    agent, config = make_agent(AgentConfig()), LoopConfig()
    slots = num_slots(RUNS, RUNS)
    specs = specs_of(list(Method), RUNS)
    stretch = SweepOptions().save_seconds * seconds / 2.0
    rows: list[Row] = []
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name) / "saves"
        saves = Saves(folder, config.frames)
        with make_pool("lean", slots) as pool:
            rollout = Rollout(agent, specs, pool, config, saved={})
            chunks = iter(rollout)
            warm_up(rollout, chunks)
            saves.write(rollout.save())
            for part in range(_STRETCHES):
                start, before = time.perf_counter(), _size(folder)
                while time.perf_counter() - start < stretch:
                    next(chunks)
                rollout.wait()
                played = time.perf_counter()
                saves.write(rollout.save())
                took = time.perf_counter() - played
                rows.append(
                    {
                        "save": part + 1,
                        "runs": RUNS,
                        "played s": round(played - start, 1),
                        "saving s": round(took, 2),
                        "share": round(took / (played - start + took), 4),
                        "bar": BAR,
                        "folder MB": round(_size(folder) / 1e6),
                        "grown by MB": round((_size(folder) - before) / 1e6),
                    }
                )
        with make_pool("lean", slots) as pool:
            start = time.perf_counter()
            runs, _ = Saves(folder, config.frames).load()
            read = time.perf_counter() - start
            next(iter(Rollout(agent, specs, pool, config, saved=runs)))
            going_on = time.perf_counter() - start
    rows[-1] |= {"reading s": round(read, 2), "to the next chunk s": round(going_on, 1)}
    return rows


def _size(folder: pathlib.Path) -> int:
    return sum(path.stat().st_size for path in folder.iterdir())
