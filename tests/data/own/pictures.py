"""The pictures of `docs/own-anatomy.md`: a kidney at falling grades, a real heart over its beat.

python -m tests.data.own.pictures BIVME      # writes docs/images/own-kidney.png and own-heart.png

Both organs are made of the page's own blocks; `BIVME` is the folder of the heart's surfaces.
"""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import torch
from PIL import Image, ImageDraw

from racines_data.card.contact_sheet import coloured
from racines_data.geometry import Pose
from racines_data.own import OwnPool, from_mesh
from racines_data.patients.labels import LABELS
from racines_data.plotting import INK, TISSUES, letters, mark_depth
from racines_data.views import VIEWS
from tests.conftest import ROOT
from tests.documents import blocks

PAGE, IMAGES = ROOT / "docs/own-anatomy.md", ROOT / "docs/images"
PATIENT, MOMENTS = 10_000, (0.0, 0.2, 0.4, 0.6, 0.8)
SIDE, LEFT, HEAD, FOOT = 240, 70, 30, 56


def kidney(picture: Path) -> None:
    """Make the page's kidney of its label map, and draw its contact sheet."""
    page = blocks(PAGE)
    with tempfile.TemporaryDirectory() as name:
        base = Path(name)
        for file in ("kidney.yaml", "params.yaml"):
            (text,) = (block.text for block in page if block.file == file)
            (base / file).write_text(text)
        (code,) = (block.text for block in page if "kidney.nii.gz" in block.text
                   and block.language == "python")  # fmt: skip
        place = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
        for words in (
            [sys.executable, "-c", code],
            ["racines", "phantom", "from-labels", "kidney.nii.gz", "--tissues", "kidney.yaml",
             "--out", "kidney"],
            ["racines", "study", "sheet", "--anatomy", "kidney", "--out", str(picture)],
        ):  # fmt: skip
            subprocess.run(words, cwd=base, env=place, check=True)


def over_the_beat(pool: OwnPool, view: str) -> tuple[np.ndarray, np.ndarray]:
    """Return images and masks, each (M, 128, 128), of a view at its nominal pose at `MOMENTS`."""
    rows = torch.zeros(len(MOMENTS), dtype=torch.int64)
    targets, number = pool.targets(rows), VIEWS.index(view)
    pose = Pose(targets.position[:, number], targets.rotation[:, number])
    phase = torch.tensor([[moment, 0.0] for moment in MOMENTS], dtype=torch.float64)
    images = pool.render(pose, rows, phase, torch.arange(len(rows)))
    return images.numpy(), pool.mask(pose, rows, phase).numpy()


def heart(surfaces: Path) -> Image.Image:
    """Draw the page's heart at moments of its beat: images of each view, and what is there."""
    with tempfile.TemporaryDirectory() as name:
        base = Path(name)
        (text,) = (block.text for block in blocks(PAGE) if block.file == "heart.yaml")
        (base / "heart.yaml").write_text(text)
        from_mesh(surfaces, base / "heart.yaml", base / "heart")
        pool = OwnPool(str(base / "heart"), [PATIENT], beating=True)
    lines = 2 * len(pool.shown)
    sheet = Image.new("RGB", (LEFT + SIDE * len(MOMENTS), HEAD + SIDE * lines + FOOT), "white")
    draw = ImageDraw.Draw(sheet)
    for column, moment in enumerate(MOMENTS):
        at = LEFT + (column + 0.5) * SIDE, HEAD / 2
        draw.text(at, f"{moment:.0%} of the beat", INK, letters(18), anchor="mm")
    mm = float(pool.pixel_size(torch.tensor([0]))) * 128 / SIDE
    seen: set[int] = set()
    for number, view in enumerate(pool.shown):
        images, masks = over_the_beat(pool, view)
        top = HEAD + 2 * number * SIDE
        draw.text((LEFT / 2, top + SIDE / 2), view, INK, letters(18), anchor="mm")
        draw.text((LEFT / 2, top + 1.5 * SIDE), "labels", INK, letters(16), anchor="mm")
        seen |= set(np.unique(masks).tolist())
        for column, (image, mask) in enumerate(zip(images, masks, strict=True)):
            picture = Image.fromarray(image).resize((SIDE, SIDE), Image.Resampling.BICUBIC)
            mark_depth(picture, mm)
            colours = Image.fromarray(coloured(image, mask, LABELS))
            colours = colours.resize((SIDE, SIDE), Image.Resampling.NEAREST)
            sheet.paste(picture, (LEFT + column * SIDE, top))
            sheet.paste(colours, (LEFT + column * SIDE, top + SIDE))
    named = [label for number, label in enumerate(LABELS) if number in seen and label in TISSUES]
    step = SIDE * len(MOMENTS) / len(named)
    for number, label in enumerate(named):
        left, middle = LEFT + number * step, sheet.height - FOOT / 2
        draw.rectangle((left, middle - 8, left + 16, middle + 8), TISSUES[label], INK)
        draw.text((left + 24, middle), label, INK, letters(16), anchor="lm")
    return sheet


def main() -> None:
    """Write both."""
    kidney(IMAGES / "own-kidney.png")
    heart(Path(sys.argv[1])).save(IMAGES / "own-heart.png", optimize=True)


if __name__ == "__main__":
    main()
