import numpy as np
import torch

from racines_data.patients import PATIENTS_VERSION, Pool
from tests.data.patients import golden


def test_five_patients_are_drawn_as_ever(pool: Pool) -> None:
    """On any processor, to one gray level; see `golden` for how they are drawn again."""
    kept = np.load(golden.PATH)
    assert str(kept["version"]) == PATIENTS_VERSION, "draw the golden frames of this version"
    other = Pool(golden.SEEDS[3:], beating=True)
    first = golden.draw(pool, torch.arange(3), torch.arange(3))
    second = golden.draw(other, torch.arange(2), torch.arange(2) + 3)
    images, masks = (np.concatenate(parts) for parts in zip(first, second, strict=True))
    off = np.abs(images.astype(int) - kept["images"].astype(int))
    assert off.max() <= 1, f"{(off > 1).sum()} pixels, by {off.max()} at most"
    assert np.array_equal(masks, kept["masks"])
