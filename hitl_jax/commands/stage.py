"""Draws a walker of `hitl_jax.walker` as gymnasium draws its own: its bodies put where ours are."""

import itertools
import math
from typing import Any

import numpy as np

from hitl_jax.walker import Walker, parts
from hitl_jax.walker.boxes import Boxes
from hitl_jax.walker.terrain import Terrain

_GRASS, _EARTH = ((76, 255, 76), (76, 204, 76)), (102, 153, 76)
_STONE = (255, 255, 255), (153, 153, 153)


class Stage(parts.official.BipedalWalker):
    """Gymnasium's walker on given ground, never stepped after its reset."""

    def __init__(self, terrain: Terrain):
        """Builds ground and bodies.

        Args:
            terrain: the ground, leaves [200].
        """
        super().__init__(render_mode="rgb_array")
        self._ground = terrain
        self.reset(seed=0)

    def _generate_terrain(self, hardcore: bool) -> None:
        self.terrain, self.terrain_poly = [], []
        self.terrain_x, self.terrain_y = parts.CORNER_X.tolist(), self._ground.heights.tolist()
        corners = zip(self.terrain_x, self.terrain_y, strict=True)
        for place, (left, right) in enumerate(itertools.pairwise(corners)):
            self.fd_edge.shape.vertices = [left, right]
            edge = self.world.CreateStaticBody(fixtures=self.fd_edge)
            edge.color1 = edge.color2 = _GRASS[place % 2]
            self.terrain.append(edge)
            below = [(right[0], 0), (left[0], 0)]
            self.terrain_poly.append(([left, right, *below], _EARTH))
        if self._ground.boxes is not None:
            self._build(self._ground.boxes)

    def _build(self, boxes: Boxes) -> None:
        sides = (boxes.low.x, boxes.low.y, boxes.high.x, boxes.high.y)
        for left, low, right, high in set(zip(*(side.tolist() for side in sides), strict=True)):
            if left < right:
                self.fd_polygon.shape.vertices = [
                    (left, low),
                    (right, low),
                    (right, high),
                    (left, high),
                ]
                box = self.world.CreateStaticBody(fixtures=self.fd_polygon)
                box.color1, box.color2 = _STONE
                self.terrain.append(box)

    def picture(self, walker: Walker) -> Any:
        """RGB bytes [H, W, 3].

        Args:
            walker: whose bodies are shown.
        """
        world = walker.world
        angles = np.asarray(world.angle, np.float64)
        centres = np.stack([world.place.x, world.place.y], -1).astype(np.float64)
        cos, sin = math.cos(angles[0]), math.sin(angles[0])
        x, y = parts.HULL_CENTRE
        centres[0] -= (cos * x - sin * y, sin * x + cos * y)
        rows = zip([self.hull, *self.legs], centres.tolist(), angles.tolist(), strict=True)
        for body, place, angle in rows:
            body.transform = (place, angle)
        self.scroll = centres[0, 0] - parts.official.VIEWPORT_W / parts.official.SCALE / 5
        self.lidar_render = 2 * len(self.lidar)  # Its rays are those of the reset.
        return self.render()
