"""Frames of patients for the study of realism, drawn from a world that is quick to make."""

import pytest
import torch

from racines_data.errors import RacinesError
from racines_data.geometry import Pose
from racines_data.views import VIEWS
from racines_models.studies.realism import patient_frames
from racines_models.studies.realism.patient_frames import SPLIT, of_patients
from racines_models.studies.realism.report import RealismConfig


class Truth:
    def __init__(self, grades: torch.Tensor):
        self.view_grade = grades


class Plain:
    """Patients of one gray each, of whom every third is never seen well."""

    views = VIEWS

    def __init__(self, seeds, beating):
        self.seeds, self.beating = torch.tensor(list(seeds)), beating

    def targets(self, rows, phase):
        assert (phase is not None) == self.beating
        down = torch.diag(torch.tensor([1.0, -1.0, -1.0]))
        shape = (len(rows), len(VIEWS))
        return Pose(torch.zeros(*shape, 3), down.expand(*shape, 3, 3))

    def judge(self, pose, rows, phase):
        assert 0.0 < float(pose.position.abs().max()) < 0.02
        return Truth((5.0 * (self.seeds % 3 > 0)).unsqueeze(1).expand(-1, len(VIEWS)))

    def render(self, pose, rows, phase, seeds):
        return self.seeds.to(torch.uint8).view(-1, 1, 1).expand(-1, 128, 128)


@pytest.mark.parametrize("beating", [False, True])
def test_each_patient_gives_one_frame_and_whom_nobody_sees_none(monkeypatch, beating):
    monkeypatch.setattr(patient_frames, "Pool", Plain)
    found = of_patients(RealismConfig(frames=7), beating)
    assert found.images[:, 0, 0].tolist() == [1, 2, 4, 5, 7, 8, 10]
    assert found.told["phantom_hearts"] == 7
    assert found.told["config"] == ("beating" if beating else "patients")
    world = found.told["world"]
    assert (world["split"], world["patients"], world["passed_over"]) == (SPLIT, [1, 10], 3)


def test_an_unknown_view_is_refused(monkeypatch):
    monkeypatch.setattr(patient_frames, "Pool", Plain)
    with pytest.raises(RacinesError, match="choose one of A4C"):
        of_patients(RealismConfig(view="XX"), False)
