"""The film of an episode: the ultrasound beside the probe over the chest, and what is believed.

+----------------+----------------+
|   ultrasound   |   the chest    |
+----------------+----------------+
|  in words      |  grades so far |
+----------------+----------------+
"""

import io

import numpy as np
from PIL import Image, ImageColor, ImageDraw

from racines_data.plotting import (
    BELIEF,
    BLUE,
    GREEN,
    INK,
    LINE,
    NIGHT,
    PALE,
    PANEL,
    PROBE,
    TRUTH,
    VIOLET,
    WARNING,
    WORDS,
    YELLOW,
    letters,
    mark_depth,
)
from racines_envs.demo.chestmap import ChestMap
from racines_envs.demo.episode import Outcome, verdict
from racines_envs.demo.watching import Shot

SIDE, GAP, LOW = 300, 10, 128
WIDTH, HEIGHT = 2 * SIDE + 3 * GAP, SIDE + LOW + 3 * GAP
EVERY, MILLISECONDS, HELD = 3, 160, 30
"""Steps from picture to picture, the time of each, and the pictures' worth that the end stands."""
COLOURS, GRAYS = 128, 32
SIGNS = (
    NIGHT, PANEL, LINE, PROBE, VIOLET, TRUTH, GREEN, BELIEF, BLUE, WARNING, "white", INK, WORDS,
    PALE, YELLOW,
)  # fmt: skip
"""Colours that the film never loses."""


def ultrasound(
    image: np.ndarray, side: int, names: dict[str, tuple[float, float]] | None = None,
    pixel: float | None = None,
) -> Image.Image:  # fmt: skip
    """Return a (128, 128) picture as RGB of so many pixels a side, with parts named in it.

    Where the side of a `pixel` is given, mm, the depth is marked.
    """
    shown = Image.fromarray(image).resize((side, side), Image.Resampling.BICUBIC).convert("RGB")
    if pixel is not None:
        mark_depth(shown, pixel * len(image) / side)
    draw = ImageDraw.Draw(shown)
    for name, (x, y) in (names or {}).items():
        draw.text((x * side, y * side), name, YELLOW, letters(max(12, side // 22)), anchor="mm",
                  stroke_width=2, stroke_fill="black")  # fmt: skip
    return shown


def kept(shots: list[Shot], every: int = EVERY) -> list[Shot]:
    """Return every so many-th shot, and the last."""
    return [shot for shot in shots if shot.step % every == 0 or shot is shots[-1]]


def frame(outcome: Outcome, chest: ChestMap, shot: Shot) -> Image.Image:
    """Return one picture of the film."""
    last = shot is outcome.shots[-1]
    named = outcome.names[0] if last else None
    sheet = _sheet(ultrasound(shot.image, SIDE, named, outcome.pixel),
                   chest.picture(outcome.shots, shot, outcome.draw.view, last))  # fmt: skip
    draw = ImageDraw.Draw(sheet)
    left, top = GAP, SIDE + 2 * GAP
    draw.text((left + 8, GAP + 6), "what the probe sees", PALE, letters(12))
    if last:
        found = outcome.found
        lines = [(verdict(outcome)[0].split(":")[0], TRUTH if found else WARNING)]
    else:
        lines = [(f"patient {outcome.draw.patient}, looking for {outcome.draw.view}", WORDS)]
    lines += [
        (f"step {shot.step} of at most 200, {0.1 * shot.step:.1f} s", PALE),
        (f"it believes: {shot.believed:.0f} ± {shot.spread:.0f} mm to go", BELIEF),
        (f"true: {shot.distance:.0f} mm to go", TRUTH),
        (f"grade it reads {max(shot.read, 0.0):.1f}, true {shot.grade:.1f}", WORDS),
    ]
    for number, (words, ink) in enumerate(lines):
        draw.text((left + 2, top + 25 * number), words, ink, letters(17 if number == 0 else 15))
    _trace(draw, outcome.shots, shot, (SIDE + 2 * GAP, top, WIDTH - GAP, HEIGHT - GAP))
    return sheet


def ending(outcome: Outcome) -> Image.Image:
    """Return the last picture: what was declared beside what the best pose shows."""
    last, draw_ = outcome.shots[-1], outcome.draw
    pair = zip((last.image, outcome.own_image), outcome.names, strict=True)
    sheet = _sheet(*(ultrasound(image, SIDE, names, outcome.pixel) for image, names in pair))
    draw = ImageDraw.Draw(sheet)
    left = "the agent's picture" if outcome.declared else "the last picture"
    for words, x in ((left, GAP), (f"the best {draw_.view} of this patient", SIDE + 2 * GAP)):
        draw.text((x + 8, GAP + 6), words, WORDS, letters(14), stroke_width=2, stroke_fill="black")
    head, text = verdict(outcome)
    draw.text((GAP + 2, SIDE + 2 * GAP), head, TRUTH if outcome.found else WARNING, letters(18))
    lines = _wrapped(draw, text, WIDTH - 2 * GAP - 4)
    for number, line in enumerate(lines[:3]):
        draw.text((GAP + 2, SIDE + 2 * GAP + 28 + 20 * number), line, WORDS, letters(14))
    words = "RACINES: simulated patient; research software, not a medical device"
    draw.text((GAP + 2, HEIGHT - GAP), words, PALE, letters(13), anchor="ld")
    return sheet


def film(outcome: Outcome, chest: ChestMap) -> bytes:
    """Return the film as a GIF: every third step, the end, and the end beside the best view."""
    frames = [frame(outcome, chest, shot) for shot in kept(outcome.shots)] + [ending(outcome)]
    palette = _palette(frames)
    few = [each.quantize(palette=palette, dither=Image.Dither.NONE) for each in frames]
    times = [MILLISECONDS] * (len(few) - 2) + [MILLISECONDS * HELD // 2, MILLISECONDS * HELD]
    buffer = io.BytesIO()
    few[0].save(buffer, "GIF", save_all=True, append_images=few[1:], duration=times, loop=0)
    return buffer.getvalue()


def _palette(frames: list[Image.Image]) -> Image.Image:
    """Return grays for the ultrasound, the signs' own colours, and those that suit the maps.

    A sign of few pixels would else be shown in the colour of something larger.
    """
    maps = [frames[at] for at in (0, len(frames) // 2, -2)]
    strip = Image.new("RGB", (SIDE, SIDE * len(maps)))
    for number, each in enumerate(maps):
        left = SIDE + 2 * GAP
        strip.paste(each.crop((left, GAP, left + SIDE, GAP + SIDE)), (0, SIDE * number))
    grays = [round(255 * i / (GRAYS - 1)) for i in range(GRAYS) for _ in range(3)]
    signs = [value for sign in SIGNS for value in ImageColor.getrgb(sign)[:3]]
    many = COLOURS - GRAYS - len(SIGNS)
    suiting = strip.quantize(many, Image.Quantize.MEDIANCUT).getpalette() or []
    palette = Image.new("P", (1, 1))
    palette.putpalette(grays + signs + suiting[: 3 * many])
    return palette


def _sheet(left: Image.Image, right: Image.Image) -> Image.Image:
    sheet = Image.new("RGB", (WIDTH, HEIGHT), NIGHT)
    for image, x in ((left, GAP), (right, SIDE + 2 * GAP)):
        sheet.paste(image.resize((SIDE, SIDE), Image.Resampling.LANCZOS), (x, GAP))
    return sheet


def _trace(
    draw: ImageDraw.ImageDraw, shots: list[Shot], shot: Shot, box: tuple[int, int, int, int]
) -> None:
    """Draw the true distance and the believed one so far, over the steps."""
    left, top, right, bottom = box
    draw.rectangle(box, fill=PANEL, outline=LINE)
    most = max(max(each.distance, each.believed) for each in shots) or 1.0
    ends, inner = max(shots[-1].step, 1), (left + 8, top + 26, right - 8, bottom - 8)
    place = left + 8.0
    for words, ink in (("mm to the view:", PALE), ("true", TRUTH), ("believed", BELIEF)):
        draw.text((place, top + 5), words, ink, letters(13))
        place += letters(13).getlength(words + " ")
    draw.text((right - 8, top + 5), f"{most:.0f} mm", PALE, letters(12), anchor="ra")
    for key, ink in (("believed", BELIEF), ("distance", TRUTH)):
        points = [
            (inner[0] + (inner[2] - inner[0]) * each.step / ends,
             inner[3] - (inner[3] - inner[1]) * getattr(each, key) / most)
            for each in shots
            if each.step <= shot.step
        ]  # fmt: skip
        if len(points) > 1:
            draw.line(points, fill=ink, width=2, joint="curve")
        draw.circle(points[-1], 3, fill=ink)


def _wrapped(draw: ImageDraw.ImageDraw, text: str, width: int) -> list[str]:
    lines = [""]
    for word in text.split():
        longer = f"{lines[-1]} {word}".strip()
        if draw.textlength(longer, letters(14)) > width:
            lines.append(word)
        else:
            lines[-1] = longer
    return lines
