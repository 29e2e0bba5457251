"""Films: what is small in a picture keeps its colour."""

from PIL import Image, ImageDraw

from hitl_jax.playback import film


def test_a_gif_shows_the_colours_that_tell_who_is_in_control():
    image = Image.radial_gradient("L").convert("RGB").resize((360, 240))
    draw, shown = ImageDraw.Draw(image), ("#CC79A7", "#009E73", "#0072B2", "#D55E00")
    for place, colour in enumerate(shown):
        draw.rectangle((10 + 20 * place, 30, 18 + 20 * place, 38), fill=colour)
    reduced = film._reduced(image).convert("RGB")
    for place, colour in enumerate(shown):
        wanted = tuple(bytes.fromhex(colour[1:]))
        seen = reduced.getpixel((14 + 20 * place, 34))
        assert max(abs(a - b) for a, b in zip(seen, wanted, strict=True)) <= 8
