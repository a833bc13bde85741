"""What each part of the phantom brings: variants, shared blocks, resuming, the list in a report."""

import dataclasses
import io
import json

import numpy as np
import pytest
import torch
from PIL import Image

from racines_data.errors import RacinesError
from racines_data.phantom import Phantom, PhantomConfig
from racines_data.phantom.anatomy import load_anatomy
from racines_data.phantom.config import BlockConfig, heart_config
from racines_data.phantom.heart import CONNECTIVE, heart
from racines_models.studies.ablation import run as ablation
from racines_models.studies.ablation.run import (
    BASE,
    NO_GRAY_MAP,
    VARIANTS,
    AblationConfig,
    Setting,
    ablate,
    draw_ablation,
    merge_into,
    pick_variants,
    poses_near,
)
from racines_models.studies.realism.report import RealFrames, RealismConfig
from tests.models.scores.test_scores import Coarse
from tests.models.studies.test_realism import speckle

COARSE = PhantomConfig(block=BlockConfig(voxel=0.004))
SETTING = Setting(COARSE, AblationConfig(hearts=1, poses=4), RealismConfig(splits=3))
NAMES = [NO_GRAY_MAP, "one heart, one setting"]


@pytest.fixture(scope="module")
def real() -> RealFrames:
    return RealFrames(speckle(10, 50, seed=1), np.arange(10), "sha")


@pytest.fixture
def baked(monkeypatch) -> list[PhantomConfig]:
    """The configurations that were baked, in order."""
    made: list[PhantomConfig] = []

    class Counted(Phantom):
        def __init__(self, config: PhantomConfig | None = None) -> None:
            made.append(config or PhantomConfig())
            super().__init__(config)

    monkeypatch.setattr(ablation, "Phantom", Counted)
    return made


def test_a_probe_of_other_settings_is_the_phantom_made_with_them():
    phantom = Phantom(COARSE)
    probe = dataclasses.replace(COARSE.probe, gain=-20.0, smoothing=(0.0, 0.0))
    target, seeds = phantom.target("A4C"), torch.zeros(1, dtype=torch.int64)
    other = phantom.with_probe(probe)
    fresh = Phantom(dataclasses.replace(COARSE, probe=probe))
    assert torch.equal(other.render(target, seeds), fresh.render(target, seeds))
    assert phantom.config is COARSE and other.config == fresh.config
    assert not torch.equal(other.render(target, seeds), phantom.render(target, seeds))


def test_every_variant_differs_from_the_full_phantom_in_its_part_alone():
    full = heart_config(COARSE, 2)
    for variant in VARIANTS[1:-1]:
        (_, config) = variant.configs(COARSE, 2)
        differing = [f.name for f in dataclasses.fields(full)]
        differing = [name for name in differing if getattr(full, name) != getattr(config, name)]
        assert len(differing) == 1, variant.name
    assert VARIANTS[0].configs(COARSE, 2)[1] == full
    assert VARIANTS[-1].configs(COARSE, 2) == [COARSE, COARSE]


def test_hearts_lack_what_their_name_says():
    def of(function: str):
        return load_anatomy(f"racines_models.studies.ablation.hearts:{function}", 3)

    whole = heart(3)
    assert any(t.sheets for t in whole.tissues) and any(t.grain for t in whole.tissues)
    assert not any(t.sheets for t in of("no_sheets").tissues)
    assert not any(t.grain for t in of("no_grain").tissues)
    assert not any(t.texture for t in of("no_texture").tissues)
    points = torch.rand(4000, 3, generator=torch.Generator().manual_seed(0)) * 0.3 - 0.15
    assert (whole.paint(points) == CONNECTIVE).any()
    assert not (of("no_layers").paint(points) == CONNECTIVE).any()


def test_poses_scatter_around_the_nominal_one():
    phantom = Phantom(COARSE)
    poses = poses_near(phantom, "A4C", 400, 3)
    off = poses.position - phantom.target("A4C").position
    assert off.std(0).tolist() == pytest.approx([0.0025, 0.0025, 0.0005], rel=0.15)
    assert off.mean(0).abs().max() < 0.0005
    assert torch.equal(poses_near(phantom, "A4C", 400, 3).position, poses.position)


def test_two_variants_are_measured_and_kept(real, baked, tmp_path):
    out = tmp_path / "ablation.json"
    counted: list[int] = []
    content = ablate(real, pick_variants(NAMES), SETTING, Coarse(), out, counted.append)
    assert json.loads(out.read_text()) == content
    assert content["n"] == 4 and content["base"]["name"] == BASE
    assert {row["name"] for row in content["ablation"]} == set(NAMES)
    for row in content["ablation"]:
        assert row["change"] == pytest.approx(row["kid"] - content["base"]["kid"])
        assert row["change_low"] <= row["change"] <= row["change_high"]
        assert row["change"] != 0 and row["low"] <= row["kid"] <= row["high"]
    assert content["ablation"][0]["change"] >= content["ablation"][1]["change"]
    assert -30 < content["gain_without_gray_map"] < -1
    assert len(baked) == 2, "the heart once for both scanner settings, and the canonical heart"
    Image.open(io.BytesIO(draw_ablation(content))).verify()

    again = ablate(real, pick_variants(NAMES), SETTING, Coarse(), out)
    assert again["ablation"] == content["ablation"] and len(baked) == 3, "only the mask's heart"
    more = SETTING._replace(config=AblationConfig(hearts=1, poses=5))
    assert ablate(real, pick_variants(NAMES), more, Coarse(), out)["n"] == 5, "measured anew"


def test_without_gray_map_the_mean_gray_stays(real):
    probed = [Phantom(each) for each in VARIANTS[0].configs(COARSE, 1)]
    mask, gain = ablation._calibrate(real.images, probed, SETTING)
    (plain,) = ablation.gray_map_variant(gain).configs(COARSE, 1)
    full = ablation._frames(probed[0], SETTING, 0)[:, mask].double().mean()
    without = ablation._frames(probed[0].with_probe(plain.probe), SETTING, 0)[:, mask]
    assert float(without.double().mean()) == pytest.approx(float(full), abs=0.2)


def test_the_list_goes_into_a_report_that_compares(tmp_path):
    row = {"name": "no grain", "kid": 0.2, "low": 0.1, "high": 0.3, "digest": "x"}
    row |= {"change": 0.05, "change_low": 0.04, "change_high": 0.06}
    report = tmp_path / "realism.json"
    with pytest.raises(RacinesError, match="no readable JSON"):
        merge_into(report, {"ablation": [row]})
    report.write_text(json.dumps({"compared": False}))
    with pytest.raises(RacinesError, match="holds no comparison"):
        merge_into(report, {"ablation": [row]})
    report.write_text(json.dumps({"compared": True, "figures": {}}))
    merge_into(report, {"ablation": [row]})
    del row["digest"]
    assert json.loads(report.read_text()) == {"compared": True, "figures": {}, "ablation": [row]}


def test_an_unknown_variant_is_refused():
    with pytest.raises(RacinesError, match="unknown variant 'no heart': choose of single look"):
        pick_variants(["no heart"])
