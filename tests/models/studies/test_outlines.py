"""Outlines: volumes of known bodies, agreement of known numbers, masks laid out wrongly."""

import numpy as np
import pytest
import torch

from racines_models.studies.sim_to_real.ejection import (
    agreement,
    disk_volume,
    ejection_fractions,
    measure_ventricle,
)
from racines_models.studies.sim_to_real.sectors import are_stretched, unstretched
from tests.models.judges.masked import hearts

MM = 1.5


def test_disks_make_the_volume_of_a_spheroid():
    y, x = np.mgrid[:128, :128] + 0.5
    mask = (((x - 64) / 20) ** 2 + ((y - 60) / 40) ** 2 < 1).astype(np.uint8)
    exact = 4 / 3 * np.pi * 20 * 20 * 40 * MM**3 / 1e3
    assert disk_volume(mask, np.array([MM, MM])) == pytest.approx(exact, rel=0.02)
    assert measure_ventricle(mask, np.array([MM, MM])).length == pytest.approx(80 * MM, rel=0.02)
    turned = np.rot90(mask).copy()
    assert disk_volume(turned, np.array([MM, MM])) == pytest.approx(exact, rel=0.02)
    assert disk_volume(mask, np.array([2 * MM, MM])) == pytest.approx(2 * exact, rel=0.02)
    mask[0, 0] = 1  # a stray pixel
    assert disk_volume(mask, np.array([MM, MM])) == pytest.approx(exact, rel=0.02)
    assert np.isnan(measure_ventricle(np.zeros((128, 128), np.uint8), np.array([MM, MM]))).all()


def test_the_mitral_plane_is_where_the_atrium_begins():
    mask = hearts(1)[0].numpy()
    with_atrium = disk_volume(mask, np.array([MM, MM]))
    assert disk_volume(np.where(mask == 3, 0, mask), np.array([MM, MM])) == pytest.approx(
        with_atrium, rel=0.05
    )
    pairs = ejection_fractions(
        hearts(2).numpy(), np.repeat(["a", "b"], 2), np.array(["ED", "ES"] * 2), np.full((4, 2), MM)
    )
    assert pairs["a"][2] == pytest.approx(100 * (1 - 0.8**3), abs=3)


def test_agreement_is_bias_limits_and_correlation():
    truth = np.linspace(30, 70, 20)
    found = truth + np.where(np.arange(20) % 2, 8.0, 4.0)
    told = agreement(np.r_[found, np.nan], np.r_[truth, 50.0], "%")
    assert told["patients"] == 20 and told["not_seen"] == 1
    assert told["bias"]["value"] == pytest.approx(6) and told["absolute"]["unit"] == "%"
    spread = 1.96 * np.std(found - truth, ddof=1)
    assert told["upper_limit"]["value"] == pytest.approx(6 + spread)
    assert told["correlation"]["value"] > 0.97 and told["correlation"]["high"] <= 1.0
    assert told["bias"]["low"] < 6 < told["bias"]["high"]
    assert agreement(np.full(9, 50.0), truth[:9], "%")["correlation"]["value"] == 0.0
    few = agreement(np.r_[found[:2], -300.0], np.r_[truth[:2], 50.0], "%", 100.0)
    assert few == {"patients": 2, "not_seen": 0, "impossible": 1}


def test_masks_that_were_stretched_to_the_square_are_put_right():
    truth = hearts(1)
    aspect = np.array([0.8, 1.25])
    place = np.arange(128) + 0.5
    tall = truth[:1, (place * 0.8).astype(int)]
    wide = truth[1:, :, ((place - 64) * 0.8 + 64).astype(int)]
    stretched = torch.cat([tall, wide])
    assert are_stretched(stretched, np.array([0.55, 1.25])) and not are_stretched(truth, aspect)
    assert not are_stretched(stretched, np.array([np.nan, np.nan]))
    put_right = unstretched(stretched, aspect)
    assert float((put_right == truth).float().mean()) > 0.99
