"""The lidar of walkers on plain terrain, computed in NumPy with Box2D's own float32 operations.

Through Box2D each ray would call back into Python; here all rays of a process are one computation.
"""

import platform
from collections.abc import Sequence

import numpy as np

from hitl_jax.walker import bipedal

_REACH = np.array(bipedal.LIDAR_REACH).T
_SPANS = np.ceil(_REACH[0] / bipedal.TERRAIN_STEP).astype(int) + 3
"""Number of edges that each ray may hit, with one more on either side."""

_WINDOW = int(_SPANS.max())
_FIRST_PAIR = np.cumsum(_SPANS) - _SPANS
_PAIR_RAY = np.repeat(np.arange(len(_SPANS)), _SPANS)
_PAIR_EDGE = np.arange(_SPANS.sum()) - _FIRST_PAIR[_PAIR_RAY]
"""All P pairs of a ray and an edge that it may hit: ray, and edge in the window."""

ROUNDS_AS_BOX2D = platform.machine().lower() in ("x86_64", "amd64")
"""Elsewhere Box2D's compiler may have fused products and sums, which rounds differently."""

CORNER_X = [corner * bipedal.TERRAIN_STEP for corner in range(bipedal.TERRAIN_LENGTH)]
"""x of the ground's corners [m]."""


class PlainLidar:
    """The edges of several walkers' plain terrains, and lidar rays against them.

    All arithmetic is float32, one operation at a time, in the order of `b2EdgeShape::RayCast`. The
    result of Box2D's search in its tree is the least fraction over all edges, whatever the order of
    the search.
    """

    def __init__(self, num_walkers: int):
        """Starts without terrain.

        Args:
            num_walkers: of this process.
        """
        # After the end of the terrain are edges of no length, which no ray hits.
        edges = bipedal.TERRAIN_LENGTH - 1 + _WINDOW
        self._columns = np.zeros((7, edges, num_walkers), np.float32)

    def set(self, walker: int, heights: Sequence[float]) -> None:
        """Sets the terrain of a walker.

        Args:
            walker: its index.
            heights: of the terrain's corners [TERRAIN_LENGTH] [m].
        """
        corner = np.array([CORNER_X, heights], np.float32)
        start, along = corner[:, :-1], np.diff(corner)
        squares = along * along
        length = np.sqrt(squares[0] + squares[1])
        inverse = np.float32(1.0) / length
        normal = np.stack([along[1] * inverse, -along[0] * inverse])
        columns = *start, *normal, *along, squares[0] + squares[1]
        self._columns[:, : start.shape[1], walker] = columns

    def fractions(self, walkers: np.ndarray, place: np.ndarray) -> np.ndarray:
        """Where each ray hits the ground, as a fraction of the ray's length.

        Args:
            walkers: indices of the walkers, int [M].
            place: positions of their hulls, float64 [2, M] holding float32 values [m].

        Returns:
            Fractions, 1 where a ray hits nothing, float32 [M, 10].
        """
        first = np.floor(place[0] / bipedal.TERRAIN_STEP).astype(np.int64) - 1
        first = np.clip(first, 0, self._columns.shape[1] - _WINDOW)
        edges = self._columns[:, first + np.arange(_WINDOW)[:, None], walkers]  # [7, window, M]
        here = place.astype(np.float32)[:, None]
        apart = edges[2:4] * (edges[0:2] - here)
        above = (apart[0] + apart[1]).take(_PAIR_EDGE, axis=0)  # [P, M]
        edges = edges.take(_PAIR_EDGE, axis=1)  # [7, P, M]
        start, normal, along, square = edges[0:2], edges[2:4], edges[4:6], edges[6]
        ray = (place[:, None] + _REACH[:, :, None]).astype(np.float32) - here
        ray = ray.take(_PAIR_RAY, axis=1)  # [2, P, M]
        with np.errstate(divide="ignore", invalid="ignore"):
            toward = normal * ray
            fraction = above / (toward[0] + toward[1])
            offset = (here + fraction * ray - start) * along
            share = (offset[0] + offset[1]) / square
            # A ray along an edge gives NaN, which is no hit.
            hit = (fraction >= 0) & (fraction <= 1) & (share >= 0) & (share <= 1)
        np.copyto(fraction, np.float32(1.0), where=~hit)
        return np.minimum.reduceat(fraction, _FIRST_PAIR, axis=0).T
