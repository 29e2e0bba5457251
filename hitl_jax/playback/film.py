"""An episode as moving pictures: the walker, and what the team was at beside it."""

import io
import pathlib
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from hitl_jax.analysis.figure_style import COLOURS, GREY, import_matplotlib
from hitl_jax.envs import WALKER, Command
from hitl_jax.envs.jax_pool import JaxPool
from hitl_jax.envs.visible_walker import StepResult, VisibleWalker
from hitl_jax.errors import InvalidValue, ResultsError, said_by
from hitl_jax.playback.draw_walker import Stage
from hitl_jax.results.atomic_files import write_bytes_atomic
from hitl_jax.results.recorded_episodes import Recording
from hitl_jax.walker import constants

FORMATS = (".gif", ".mp4")
_RATE = 50  # steps a second
_GIF_EVERY = 2  # steps a picture: viewers slow down what is faster than 25 a second
_GIF_HOLD = 1500  # milliseconds of the last picture, before the film begins again
_HUMAN, _MACHINE, _ALARM = "#CC79A7", COLOURS["hitl-ac"], COLOURS["srl"]
_PANEL = 78  # height of what is written over the sky, in pixels
_GAUGE = (300, 580)  # from where to where it reaches, in pixels
_NOT_DRAWN = (RuntimeError, AttributeError, TypeError, ValueError)
"""What environments raise that cannot draw themselves, or not here."""
_FONT = ("fonts", "ttf", "DejaVuSans.ttf")
"""Below matplotlib's data."""


class Caption(NamedTuple):
    """What does not change during a film.

    Attributes:
        title: which episode it is.
        indicator: name of c_t.
        unit: its unit.
        indicators: c_t at each step, [T].
        span: the greatest |c| that the gauge shows.
    """

    title: str
    indicator: str
    unit: str
    indicators: np.ndarray
    span: float


Steps = Iterator[tuple[Any, Any, float]]
"""For each step s_t [O], a picture of it or None, and r_t."""


def play(backend: str, env_id: str, seed: int, actions: np.ndarray, pictures: bool = True) -> Steps:
    """Plays an episode again.

    Args:
        backend: that plays.
        env_id: gymnasium's name of the environment.
        seed: reset seed.
        actions: executed actions, [T, A].
        pictures: whether to draw.

    Returns:
        Its steps.

    Raises:
        ImportError: if Box2D is needed and missing; one line that says what to install.
        ResultsError: one line, if the environment cannot draw itself here.
    """
    if env_id != WALKER:
        if backend == "jax":
            raise ResultsError(f"{env_id} of backend jax cannot be drawn")
        yield from _played_by_gymnasium(env_id, seed, actions, pictures)
        return
    plant = _JaxPlant() if backend == "jax" else VisibleWalker()
    observation = plant.reset(seed)
    stage = Stage(**plant.terrain()) if pictures else None
    for action in actions:
        picture = stage.picture(plant.bodies()) if stage else None
        answer = plant.step(action)
        yield observation, picture, answer.reward
        observation = answer.observation


def _played_by_gymnasium(env_id: str, seed: int, actions: np.ndarray, pictures: bool) -> Steps:
    """As the environment draws itself."""
    import gymnasium

    from hitl_jax.envs.spaces import action_map

    try:
        mode = "rgb_array" if pictures else None
        env = gymnasium.make(env_id, disable_env_checker=True, render_mode=mode)
        observation, _ = env.reset(seed=seed)
        scaled = action_map(env_id, env.action_space)(actions)
        for action in scaled:
            picture = Image.fromarray(np.asarray(env.render())) if pictures else None
            after, reward, *_ = env.step(action)
            yield observation, picture, float(np.float32(np.asarray(reward).item()))
            observation = after
        env.close()
    except (gymnasium.error.Error, ImportError, *_NOT_DRAWN) as error:
        raise ResultsError(f"{env_id} cannot be drawn here: {said_by(error)}") from error


class _JaxPlant:
    """The walker in JAX, played and seen as `VisibleWalker` is."""

    def __init__(self) -> None:
        self._pool = JaxPool(1, 1)
        self._seed = np.zeros(1, np.uint32)

    def reset(self, seed: int) -> np.ndarray:
        self._seed[0] = seed
        return self._tick(Command.RESET, np.zeros(4)).observation

    def step(self, action: np.ndarray) -> StepResult:
        return self._tick(Command.STEP, action)

    def _tick(self, command: int, action: np.ndarray) -> StepResult:
        answer = self._pool.step(np.array([command]), action[None], self._seed)
        return StepResult(
            answer.observation[0],
            float(answer.reward[0]),
            bool(answer.terminated[0]),
            bool(answer.truncated[0]),
        )

    def terrain(self) -> dict[str, list[float]]:
        heights = self._pool.walker(0).terrain.heights
        return {"x": constants.CORNER_X.tolist(), "y": np.asarray(heights).tolist()}

    def bodies(self) -> list[tuple[float, ...]]:
        world = self._pool.walker(0).world
        angles = np.asarray(world.angle, np.float64)
        places = np.stack([world.place.x, world.place.y], -1).astype(np.float64)
        cos, sin = np.cos(angles[0]), np.sin(angles[0])
        places[0] -= np.array([[cos, -sin], [sin, cos]]) @ constants.HULL_CENTRE
        return [tuple(body) for body in np.column_stack([places, angles]).tolist()]


def annotate(
    pictures: Iterable[tuple[Image.Image, float]], episode: Recording, caption: Caption
) -> Iterator[Image.Image]:
    """Writes over each picture how the team stood.

    Args:
        pictures: of each step, with the return until then.
        episode: the steps.
        caption: the rest.
    """
    path = pathlib.Path(import_matplotlib().get_data_path(), *_FONT)
    font, small = (ImageFont.truetype(path, size) for size in (15, 12))
    columns = {
        name: episode.column(name) for name in ("boundary", "alarmed", "human_action", "control")
    }
    for step, (picture, so_far) in enumerate(pictures):
        boundary, alarmed, acts, control = (column[step] for column in columns.values())
        indicator = caption.indicators[step]
        image = picture.copy()
        draw = ImageDraw.Draw(image, "RGBA")
        draw.rectangle((0, 0, image.width, _PANEL), fill=(255, 255, 255, 215))
        draw.text((10, 5), caption.title, GREY, small)
        draw.text((10, 24), f"step {step + 1}   return {so_far:.1f}", "black", font)
        who, colour = ("machine in control", _MACHINE)
        if acts or control:
            who, colour = ("HUMAN in control" if acts else "HUMAN intervenes", _HUMAN)
        draw.rectangle((10, 52, 24, 66), fill=colour)
        draw.text((32, 50), who, "black", font)
        if alarmed:
            draw.text((205, 50), "! alarm", _ALARM, font)
        _gauge(draw, float(indicator), float(boundary), caption, bool(alarmed), small)
        yield image


def _gauge(
    draw: ImageDraw.ImageDraw,
    indicator: float,
    boundary: float,
    caption: Caption,
    alarmed: bool,
    font: ImageFont.FreeTypeFont,
) -> None:
    left, right = _GAUGE

    def place(value: float) -> float:
        share = min(max(value / caption.span, -1.0), 1.0)
        return (left + right) / 2 + share * (right - left) / 2

    text = f"{caption.indicator} {indicator:+.2f} {caption.unit}"
    if np.isfinite(boundary):
        text += f"   boundary ±{abs(boundary):.2f} {caption.unit}"
        draw.rectangle((place(-abs(boundary)), 36, place(abs(boundary)), 50), fill="#CFE3F2")
        for side in (-abs(boundary), abs(boundary)):
            draw.line((place(side), 32, place(side), 54), fill=_MACHINE, width=2)
    draw.text((left, 5), text, "black", font)
    draw.line((left, 43, right, 43), fill=GREY)
    for tick in (-caption.span, 0.0, caption.span):
        draw.line((place(tick), 40, place(tick), 46), fill=GREY)
        draw.text((place(tick), 56), f"{tick:g}", GREY, font, anchor="mt")
    here, colour = place(indicator), _ALARM if alarmed else "black"
    draw.polygon(((here, 44), (here - 6, 30), (here + 6, 30)), fill=colour)


def write(path: pathlib.Path, images: Iterable[Image.Image], width: int) -> None:
    """Writes a film at the walker's own pace: 50 steps a second.

    Args:
        path: its ending, one of `FORMATS`, says what is written.
        images: of each step; at least one.
        width: of the film, in pixels.

    Raises:
        ResultsError: if it cannot be written.
        ImportError: if the extra for MP4 is not there.
    """
    to_bytes = _to_gif if path.suffix == ".gif" else _to_mp4
    write_bytes_atomic(path, to_bytes(_resized(images, width)))


def require_format(path: pathlib.Path) -> None:
    """Notices before any work that a film cannot be written.

    Raises:
        InvalidValue: in one line, for another ending.
        ImportError: in one line, if the extra for MP4 is not there.
    """
    if path.suffix not in FORMATS:
        raise InvalidValue("out", path, f"must end in {' or '.join(FORMATS)}")
    if path.suffix == ".mp4":
        _import_av()


def _resized(images: Iterable[Image.Image], width: int) -> Iterator[Image.Image]:
    """To this width, made even as is the height: MP4 wants it so."""
    for image in images:
        height = round(image.height * width / image.width)
        yield image.resize((width // 2 * 2, height // 2 * 2), Image.Resampling.LANCZOS)


def _to_gif(images: Iterable[Image.Image]) -> bytes:
    """Every `_GIF_EVERY`-th picture and the last, in which an intervention can end the episode."""
    kept = []
    for step, image in enumerate(images):
        last, missing = image, step % _GIF_EVERY > 0
        if not missing:
            kept.append(_reduced(image))
    if missing:
        kept.append(_reduced(last))
    file = io.BytesIO()
    kept[0].save(
        file,
        "GIF",
        save_all=True,
        append_images=kept[1:],
        duration=[1000 * _GIF_EVERY // _RATE] * (len(kept) - 1) + [_GIF_HOLD],
        loop=0,
        optimize=True,
    )
    return file.getvalue()


def _reduced(image: Image.Image) -> Image.Image:
    """In 64 colours of its own; rare ones too, such as that of who is in control."""
    return image.quantize(64, method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)


def _to_mp4(images: Iterable[Image.Image]) -> bytes:
    av = _import_av()
    file = io.BytesIO()
    with av.open(file, "w", format="mp4") as container:
        stream = container.add_stream("h264", rate=_RATE)
        stream.pix_fmt = "yuv420p"  # what every player reads
        for image in images:
            if not stream.codec_context.is_open:
                stream.width, stream.height = image.size
            container.mux(stream.encode(av.VideoFrame.from_image(image)))
        container.mux(stream.encode())
    return file.getvalue()


def _import_av() -> Any:
    try:
        import av
    except ImportError as error:
        raise ImportError(
            'MP4 needs PyAV: pip install -e ".[video]" (or name a file that ends in .gif)'
        ) from error
    return av
