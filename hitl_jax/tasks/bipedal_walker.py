"""BipedalWalker, plain and hardcore: with one human, who has seen the plain one alone."""

from hitl_jax.results.episode_measures import WALKER_ENDS
from hitl_jax.tasks.task import TASKS, Task

TASKS.register("BipedalWalker-v3", "the paper's walker, hull angle in rad")(
    Task("BipedalWalker-v3", WALKER_ENDS, solved=300.0)
)
TASKS.register("BipedalWalkerHardcore-v3", "the same over stumps, pits and stairs")(
    Task("BipedalWalkerHardcore-v3", WALKER_ENDS, solved=300.0)
)
