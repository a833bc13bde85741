"""A picture of what disturbances do to a picture, at their strongest.

python -m tests.envs.studies.disturbances FILE.png
"""

import sys
from pathlib import Path

import torch
from PIL import Image, ImageDraw

from racines_data.geometry import Pose
from racines_data.patients.pool import Pool
from racines_data.patients.population import draw_patient
from racines_data.plotting import letters, mark_depth
from racines_data.randomness import derive
from racines_envs.studies.robustness.disturbances import DISTURBANCES, disturbed

PATIENTS = 10_000, 10_003
SHOWN = ("nothing", "haze", "cover", "ribs", "gain", "gray map", "noise", "reverberation",
         "coupling loss")  # fmt: skip
SIDE, HEAD = 200, 26
"""Pixels of a picture, and of the names above."""
TABLE = {
    "columns": ["disturbance", "what happens", "mild, moderate, strong"],
    "rows": [
        [f"`{name}`", each.what,
         f"{', '.join(f'{amount:g}' for amount in each.amounts)} {each.unit}"]
        for name, each in DISTURBANCES.items()
    ],
}  # fmt: skip
"""What the documentation says of them."""


def draw(path: Path) -> None:
    """Draw two patients' A4C, a column a disturbance."""
    sheet = Image.new("L", (SIDE * len(SHOWN), HEAD + SIDE * len(PATIENTS)))
    labels = ImageDraw.Draw(sheet)
    for row, seed in enumerate(PATIENTS):
        for column, name in enumerate(SHOWN):
            each = DISTURBANCES.get(name)
            applied = {} if each is None else {each: each.amounts[2]}
            pool, one = Pool([disturbed(draw_patient(seed), applied)]), torch.tensor([0])
            target = pool.targets(one)
            pose = Pose(target.position[:, 0], target.rotation[:, 0])
            images = pool.render(pose, one, None, torch.tensor([7]))
            if each is not None and each.image is not None:
                images = each.image(images, derive(torch.tensor([seed])), each.amounts[2])
            image = Image.fromarray(images[0].numpy())
            mm = float(pool.pixel_size(one)) * image.height / SIDE
            image = image.resize((SIDE, SIDE), Image.Resampling.BICUBIC)
            mark_depth(image, mm)
            sheet.paste(image, (column * SIDE, HEAD + row * SIDE))
            if row == 0:
                middle = (column + 0.5) * SIDE, HEAD / 2
                labels.text(middle, name, 255, letters(18), anchor="mm")
    sheet.save(path, optimize=True)


if __name__ == "__main__":
    draw(Path(sys.argv[1]))
