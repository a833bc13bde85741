"""The strong augmentation: by seed and by name, masks with their images, what black stays."""

import pytest
import torch

from racines_data.errors import RacinesError
from racines_models.training.augmentation import (
    PARTS,
    StrongAugmentation,
    spoil,
    strengthen,
)

SEEDS = torch.arange(6) * 7919 + 5


@pytest.fixture(scope="module")
def frames():
    """(6, 1, 64, 64) images in [-1, 1]: a disk of light in a gray sector; its (6, 64, 64) masks."""
    y, x = torch.meshgrid(torch.arange(64.0), torch.arange(64.0) - 31.5, indexing="ij")
    sector = (torch.atan2(x, y).abs() < 0.6) & (x.hypot(y) < 60)
    disk = x.hypot(y - 36) < 10
    light = (0.3 * sector + 0.4 * disk).expand(6, 1, 64, 64)
    return light * 2 - 1, disk.to(torch.uint8).expand(6, 64, 64)


@pytest.mark.parametrize("part", PARTS[:-1])
def test_each_part_does_something_by_its_own_name_and_stream(part, frames):
    x, masks = frames
    config = StrongAugmentation(parts=(part,))
    one, moved = strengthen(x, SEEDS, config, masks)
    assert not torch.equal(one, x) and one.shape == x.shape and moved is not None
    assert float(one.min()) >= -1.0 and float(one.max()) <= 1.0
    apart = [strengthen(x[i : i + 1], SEEDS[i : i + 1], config)[0] for i in range(6)]
    assert torch.allclose(torch.cat(apart), one, atol=1e-6)
    if part not in ("rotation", "scale", "sector"):
        assert torch.equal(moved, masks)
        assert bool((one[x == -1.0] == -1.0).all())


def test_no_part_is_on_unless_it_is_named_and_an_unknown_one_is_refused(frames):
    x, masks = frames
    same, kept = strengthen(x, SEEDS, StrongAugmentation(), masks)
    assert torch.allclose(same, x, atol=1e-6) and torch.equal(kept, masks)
    assert not bool(spoil(x, SEEDS, StrongAugmentation())[1].any())
    with pytest.raises(RacinesError, match="no part 'fog'; choose of rotation"):
        StrongAugmentation(parts=("fog",))


@pytest.mark.parametrize("part", ["rotation", "scale", "sector"])
def test_a_mask_goes_where_its_image_goes(part, frames):
    x, masks = frames
    moved, labels = strengthen(x, SEEDS, StrongAugmentation(parts=(part,)), masks)
    bright = (moved[:, 0] > 0.2).float()
    overlap = (bright * labels).sum((1, 2)) * 2 / (bright.sum((1, 2)) + labels.sum((1, 2)))
    assert float(overlap.min()) > 0.93
    assert not torch.equal(labels, masks)


def test_negatives_are_the_named_share_and_nothing_is_lost_by_them(frames):
    x, _ = frames
    config = StrongAugmentation(parts=("negatives",), negatives=0.5)
    many = x[:1].expand(400, -1, -1, -1)
    changed, which = spoil(many, torch.arange(400), config)
    assert 0.4 < float(which.float().mean()) < 0.6
    assert torch.equal(changed[~which], many[~which])
    light = changed.flatten(1).sort(1).values
    assert torch.allclose(light, many.flatten(1).sort(1).values)  # every pixel is still there
    kinds = {tuple(each.flatten().tolist()) for each in changed[which]}
    assert len(kinds) > 3  # upside down, two sides, and shuffles


def test_a_share_of_the_images_is_left_as_it_is(frames):
    x, masks = (part[:1].expand(40, *part.shape[1:]) for part in frames)
    seeds = torch.arange(40) * 7919 + 5
    some = StrongAugmentation(("rotation", "gain"), share=0.5)
    varied, moved = strengthen(x, seeds, some, masks)
    all_of, all_moved = strengthen(x, seeds, StrongAugmentation(("rotation", "gain")), masks)
    assert moved is not None and all_moved is not None
    left = (varied == x).flatten(1).all(1)
    assert torch.equal(varied[left], x[left]) and 0.2 < float(left.float().mean()) < 0.8
    assert torch.equal(varied[~left], all_of[~left]) and torch.equal(moved[~left], all_moved[~left])
    assert torch.equal(moved[left], masks[left])
    alone, _ = strengthen(x[5:6], seeds[5:6], some, masks[5:6])
    assert torch.equal(alone, varied[5:6])
    with pytest.raises(RacinesError, match=r"strong\.share 1\.5: give 0 to 1"):
        StrongAugmentation(share=1.5)
