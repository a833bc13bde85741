"""What generators draw of patients whom they never saw, held beside real frames."""

import json

import pytest
import torch
from torch import Tensor
from typer.testing import CliRunner

from racines_data.errors import RacinesError
from racines_leaderboard.cli.command import app
from racines_models.scores import features, metrics
from racines_models.scores.on_patients import open_for_patients
from racines_models.studies.sim_to_real import drawn, imported
from racines_models.studies.sim_to_real.drawn import SIMULATOR, DrawnConfig, draw, likeness, wanted
from racines_models.studies.sim_to_real.imported import measure_imported
from tests.models.scores.test_scores import Coarse

SMALL = DrawnConfig(patients=2, poses=24)


@pytest.fixture(scope="module")
def shown() -> drawn.Wanted:
    return wanted(SMALL)


class Drawn:
    """Draws noise, and keeps whom it met."""

    scout = 1

    def __init__(self) -> None:
        self.met: list[Tensor] = []

    def adapt(self, images: Tensor, parameters: Tensor, seed: int):
        self.met.append(images)
        return self

    def generate(self, parameters: Tensor, seed):
        noise = torch.Generator().manual_seed(len(self.met))
        shape = len(parameters), 128, 128
        return torch.randint(0, 255, shape, generator=noise, dtype=torch.uint8)


def test_each_patient_is_met_by_their_own_scout(shown):
    assert len(shown.row) >= 30 and shown.row.unique().tolist() == [0, 1]
    assert not torch.equal(shown.scouts[0], shown.scouts[1])
    generator = Drawn()
    images = draw(generator, shown, 0)
    for met, scout in zip(generator.met, shown.scouts, strict=True):
        assert torch.equal(met, scout)
    again = torch.Generator().manual_seed(2)
    count = int((shown.row == 1).sum())
    expected = torch.randint(0, 255, (count, 128, 128), generator=again, dtype=torch.uint8)
    assert torch.equal(images[shown.row == 1], expected)


def test_kid_is_that_of_equal_sets_and_tells_near_from_far(shown):
    extractor, real = Coarse(), shown.truth.flip(0)
    retrieval = open_for_patients("nearest-pose", None)
    told = likeness(
        {"nearest-pose": retrieval, "noise": [Drawn(), Drawn()]},
        shown,
        {"real": real},
        extractor,
    )
    found = {name: sets["real"] for name, sets in told["kid"].items()}
    assert list(found) == [SIMULATOR, "nearest-pose", "noise"]
    expected = metrics.kid(extractor(draw(retrieval[0], shown, 0)), extractor(real))
    assert found["nearest-pose"]["value"] == pytest.approx(expected, rel=1e-6)
    assert found[SIMULATOR]["value"] < found["nearest-pose"]["value"] < found["noise"]["value"]
    assert told["n"] == found["noise"]["n"] == len(shown.row) and told["patients"] == 2
    noise = found["noise"]["settings"]
    assert noise["trainings"] == 2 and len(noise["by_training"]) == 2
    assert found["noise"]["low"] <= found["noise"]["value"] <= found["noise"]["high"]
    with pytest.raises(RacinesError, match="19 frames: KID of what generators draw needs 20"):
        likeness({}, shown, {"real": real[:19]}, extractor)
    with pytest.raises(RacinesError, match="view AAA: choose one of A4C"):
        wanted(DrawnConfig(patients=1, view="AAA"))


def test_the_command_tells_it_of_generators_that_are_named(shown, tiny_root, tmp_path, monkeypatch):
    def measure(store, grader, pose, extractor):
        return measure_imported(store, pose=pose)

    monkeypatch.setattr(imported, "measure_imported", measure)
    monkeypatch.setattr(drawn, "wanted", lambda *given: shown)
    monkeypatch.setattr(features, "InceptionFeatures", Coarse)
    words = ["study", "sim-to-real", "nearest-pose", "--real", str(tiny_root), "--no-grader"]
    done = CliRunner().invoke(app, [*words, "--out", str(tmp_path / "told")])
    assert done.exit_code == 0, done.output
    told = json.loads((tmp_path / "told.json").read_text())["drawn"]
    assert set(told["kid"]) == {SIMULATOR, "nearest-pose"} and told["config"]["view"] == "A4C"
    assert told["weights"] == {"nearest-pose": None}
    assert "A4C of patients never seen" in done.stdout and "nearest-pose" in done.stdout
    monkeypatch.setattr(
        imported, "measure_imported", None
    )  # it is told before anything is measured
    none = CliRunner().invoke(app, [*words[:2], "nobody", *words[3:]])
    assert none.exit_code != 0 and "nobody" in str(none.exception)
    for name in ("drawn.onnx", "drawn.parquet"):
        none = CliRunner().invoke(app, [*words[:2], name, *words[3:]])
        assert f"{name}: a file cannot adapt" in str(none.exception)
