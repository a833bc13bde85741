"""Generators on an organ of one's own: built, trained and scored by the usual commands."""

import json
from pathlib import Path

import pytest

from racines_data.own import from_mesh
from racines_models.scores import features, scoring
from tests.leaderboard.called import racines
from tests.models.scores.test_scores import Coarse

pytest.importorskip("trimesh", reason="needs racines[anatomy]")
organs = pytest.importorskip("tests.data.own.organs")

PARAMS = """\
data:
  frames: 400
  workers: 1
  phantom: {shortest: 20, longest: 30, phantom: {anatomy: cup}}
generators:
  scene-field:
    voxel: 0.006
    coarse_voxel: 0.012
    training: {images: 64, batch_size: 16, warmup_images: 16}
scores: {samples: 24, speed: false}
"""


@pytest.mark.thorough
def test_generators_run_unchanged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    for module in (features, scoring):
        monkeypatch.setattr(module, "InceptionFeatures", Coarse)
    monkeypatch.chdir(tmp_path)
    sheet = organs.write_sheet(tmp_path / "cup.yaml", organs.CUP)
    from_mesh(organs.write_cup(tmp_path / "meshes"), sheet, tmp_path / "cup")
    (tmp_path / "params.yaml").write_text(PARAMS)
    racines("data", "build")
    found = {}
    for name in ("nearest-pose", "mean-image", "scene-field"):
        racines("train", "generator", name)
        racines("eval", "generator", name, "--no-grader", "--no-pose")
        scores = json.loads((tmp_path / "models/runs/scores" / f"{name}.json").read_text())
        assert scores["dataset"]["source"] == "phantom" and scores["metrics"]["ssim"]["n"] == 24
        found[name] = scores["metrics"]
    assert found["nearest-pose"]["copies"]["value"] == 1.0
    assert found["nearest-pose"]["kid"]["value"] < found["mean-image"]["kid"]["value"]
    assert len({round(each["ssim"]["value"], 6) for each in found.values()}) == len(found)
