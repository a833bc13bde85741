"""Real frames by the usual commands: a rotation imported, trained on and scored."""

import json
from pathlib import Path

import pytest

from racines_models.scores import features, scoring
from tests.conftest import ROOT
from tests.data.sources.rotation_folder import PHASES, write_rotation
from tests.leaderboard.called import racines
from tests.models.scores.test_scores import Coarse

GRADER = ROOT / "models/weights/phantom-patients/grader"
PARAMS = """\
generators:
  scene-field:
    probe: {kind: plane, depth: 0.048, beams: 16, samples: 24}
    voxel: 0.006
    coarse_voxel: 0.012
    training: {images: 64, batch_size: 16, warmup_images: 16}
scores: {samples: 30, speed: false}
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["nearest-pose", pytest.param("scene-field", marks=pytest.mark.thorough)]
)
def test_import_train_and_score(tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch):
    """Block means stand in the place of Inception where nothing was learned."""
    if name == "nearest-pose":
        for module in (features, scoring):
            monkeypatch.setattr(module, "InceptionFeatures", Coarse)
    monkeypatch.chdir(tmp_path)
    write_rotation(tmp_path / "heart", turns=36)
    (tmp_path / "params.yaml").write_text(PARAMS)
    words = "--source", "rotation", "--set", "split=gap", "--out", "rotation", "--workers", "1"
    racines("data", "import", "heart", *words)
    racines("train", "generator", name, "--data", "rotation")
    alone = "--data", "rotation", "--no-grader", "--no-pose"
    racines("eval", "generator", name, *alone)
    scores = json.loads((tmp_path / "models/runs/scores" / f"{name}.json").read_text())
    figures, dataset = scores["metrics"], scores["dataset"]
    assert dataset["source"] == "rotation" and dataset["scale"] == "unknown" and dataset["phase"]
    assert {"ssim", "psnr", "fid", "kid", "feature_distance"} <= set(figures)
    assert {"ssim_neighbour", "feature_distance_neighbour", "ssim_train"} <= set(figures)
    assert not any(key.endswith("_mm") for key in figures)
    assert figures["ssim"]["value"] < figures["ssim_neighbour"]["value"]
    assert sum(each["ssim"]["n"] for each in scores["by_stratum"].values()) == figures["ssim"]["n"]
    assert figures["ssim"]["n"] % PHASES == 0
    assert any("One heart" in note for note in scores["notes"])
    assert not any("grader" in key for key in figures)
    judge = "--no-pose", "--grader", str(GRADER), "--force"
    racines("eval", "generator", name, "--data", "rotation", *judge)
    judged = json.loads((tmp_path / "models/runs/scores" / f"{name}.json").read_text())["metrics"]
    assert judged["feature_distance"] == figures["feature_distance"]
    assert judged["feature_distance_grader"]["n"] == figures["ssim"]["n"]
    assert judged["feature_distance_grader"]["value"] > 0 and "fid_grader" in judged
    assert "view_agreement" not in judged  # nobody knows the views of a recording
    trained = json.loads((tmp_path / "models/runs" / name / "config.json").read_text())
    assert trained["data"]["phase"] is True and trained["data"]["scale"] == "unknown"
