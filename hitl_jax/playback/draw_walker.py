"""Draws a walker much as gymnasium draws its own, from where its bodies are."""

import itertools
import math
from collections.abc import Sequence

from PIL import Image, ImageDraw

from hitl_jax.envs.visible_walker import outlines
from hitl_jax.walker import bipedal

_FINER = 2
"""Drawn so many times larger and then shrunk: Pillow's edges are not smooth."""
_SCALE = bipedal.SCALE * _FINER
_WIDTH, _HEIGHT = bipedal.VIEWPORT_W * _FINER, bipedal.VIEWPORT_H * _FINER
_LEFT = bipedal.VIEWPORT_W / bipedal.SCALE / 5
"""Of the hull to the left border [m]."""

_SKY, _EARTH = (215, 215, 255), (102, 153, 76)
_GRASS = ((76, 255, 76), (76, 204, 76))
_FLAG, _BLACK = (230, 51, 0), (0, 0, 0)
_FLAG_PLACE = 3 * bipedal.TERRAIN_STEP
_FLAG_CORNERS = ((0, 50), (0, 40), (25, 45))
"""From its foot [pixels]."""
_FILLS = ((127, 51, 229), (178, 101, 152), (178, 101, 152), (128, 51, 102), (128, 51, 102))
_LINES = ((76, 76, 127), (127, 76, 101), (127, 76, 101), (77, 26, 51), (77, 26, 51))
"""Of hull, thigh, shin, thigh and shin."""
_ORDER = (1, 2, 3, 4, 0)
"""In which they are drawn."""

Body = tuple[float, ...]
"""Place [m] and angle [rad]."""
Points = Sequence[tuple[float, float]]


class Stage:
    """Plain ground, on which a walker is drawn."""

    def __init__(self, x: Sequence[float], y: Sequence[float]):
        """Takes the corners of the ground [m]."""
        self._corners = list(zip(x, y, strict=True))

    def picture(self, bodies: Sequence[Body]) -> Image.Image:
        """A picture in gymnasium's size.

        Args:
            bodies: hull, thigh, shin, thigh and shin.
        """
        camera = max(bodies[0][0] - _LEFT, 0.0)
        image = Image.new("RGB", (_WIDTH, _HEIGHT), _SKY)
        draw = ImageDraw.Draw(image)

        def seen(points: Points) -> list[tuple[float, float]]:
            return [((x - camera) * _SCALE, _HEIGHT - y * _SCALE) for x, y in points]

        for place, (left, right) in enumerate(itertools.pairwise(self._corners)):
            if left[0] <= camera + bipedal.VIEWPORT_W / bipedal.SCALE and right[0] >= camera:
                draw.polygon(seen([left, right, (right[0], 0), (left[0], 0)]), fill=_EARTH)
                draw.line(seen([left, right]), fill=_GRASS[place % 2], width=_FINER)
        shapes = list(zip(outlines(), bodies, _FILLS, _LINES, strict=True))
        for outline, body, fill, line in (shapes[part] for part in _ORDER):
            corners = seen(_moved(outline, body))
            draw.polygon(corners, fill=fill, outline=line, width=_FINER)
        foot = (_FLAG_PLACE, bipedal.TERRAIN_HEIGHT)
        flag = [
            (foot[0] + x / bipedal.SCALE, foot[1] + y / bipedal.SCALE) for x, y in _FLAG_CORNERS
        ]
        draw.line(seen([foot, flag[0]]), fill=_BLACK, width=_FINER)
        draw.polygon(seen(flag), fill=_FLAG, outline=_BLACK)
        return image.reduce(_FINER)


def _moved(outline: Points, body: Body) -> Points:
    left, low, angle = body
    cos, sin = math.cos(angle), math.sin(angle)
    return [(left + cos * x - sin * y, low + sin * x + cos * y) for x, y in outline]
