"""Brax's own PPO on our walker: `hitl-jax brax-ppo`.

An example of what else the walker is for; nothing here is tuned.
"""

import time
from typing import Any

from hitl_jax.console.cli import checking_input
from hitl_jax.console.output import say
from hitl_jax.sweep.compile_cache import keep_programs
from hitl_jax.walker.brax_ppo import PpoOptions, run


def main(options: PpoOptions) -> int:
    """Trains, and prints a line for each test.

    Args:
        options: how.

    Returns:
        The exit code.
    """
    with checking_input():
        options.checked()
    keep_programs()
    started = time.monotonic()

    def tell(steps: int, metrics: dict[str, Any]) -> None:
        if "eval/episode_reward" in metrics:
            mean, spread = (metrics[f"eval/episode_reward{end}"] for end in ("", "_std"))
            say(
                f"{steps:,} steps, {time.monotonic() - started:,.0f} s: "
                f"return {float(mean):.1f} (standard deviation {float(spread):.1f})"
            )

    run(options, tell)
    return 0
