"""Frames of five patients, as they were when this world's version was set.

python -m tests.data.patients.golden      # draw them again; only together with a new version
"""

from pathlib import Path

import numpy as np
import torch

from racines_data.geometry import Pose
from racines_data.patients import PATIENTS_VERSION, Pool

PATH = Path(__file__).with_name("golden.npz")
SEEDS = (10_000, 10_008, 10_039, 10_012, 10_010)
"""A healthy one, a dilated and a hypertrophied LV, enlarged atria, a dilated RV; a view each."""


def draw(pool: Pool, rows: torch.Tensor, views: torch.Tensor) -> tuple[np.ndarray, np.ndarray]:
    """Return images and masks of rows' patients at a view each, at moments of beat and breath."""
    each = torch.arange(len(rows))
    phase = torch.stack([views / 5.0 + 0.1, views / 7.0], 1).double()
    targets = pool.targets(rows, phase)
    # Rounded: which pose is best may differ in a last bit, and that is not what is compared here.
    position = targets.position[each, views].double().round(decimals=5)
    rotation = targets.rotation[each, views].double().round(decimals=6)
    pose = Pose(position, rotation)
    images = pool.render(pose, rows, phase, views + 3)
    return images.numpy(), pool.mask(pose, rows, phase).numpy()


def main() -> None:
    """Write the frames."""
    images, masks = draw(Pool(SEEDS, beating=True), torch.arange(5), torch.arange(5))
    np.savez_compressed(PATH, images=images, masks=masks, version=PATIENTS_VERSION)


if __name__ == "__main__":
    main()
