"""Rows that do not know how many others there are.

XLA multiplies a batch of rows with weights that they share as one product, and rounds a row's sums
by the number of the rows and by its place among them. What a person's network tells of one walker
would then depend on the walkers beside it.
"""

from collections.abc import Callable

import chex
import jax


def row_by_row(function: Callable[[chex.Array], chex.Array]) -> Callable[[chex.Array], chex.Array]:
    """A function of one row that gives the same, to the last bit, in a batch of any size on a CPU.

    There a batch is a loop over its rows; on an accelerator it is one product, as usual.

    Args:
        function: maps one row [O] to an array. Its parameters must be the same for all rows.
    """

    @jax.custom_batching.custom_vmap
    def alone(row: chex.Array) -> chex.Array:
        return function(row)

    @alone.def_vmap
    def _(axis_size: int, batched: list[bool], rows: chex.Array) -> tuple[chex.Array, bool]:
        del axis_size, batched
        result: chex.Array = jax.lax.platform_dependent(
            rows,
            cpu=lambda rows: jax.lax.map(alone, rows),
            default=jax.vmap(function),
        )
        return result, True

    return alone
