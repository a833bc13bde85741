"""A grader of another organ: its heads, its file and its report have that organ's labels."""

import json

import pytest
import torch

from racines_data.errors import RacinesError
from racines_data.views import LABELS
from racines_models.judges.grader.model import Grader, GraderNetwork
from racines_models.judges.grader.report import examine
from racines_models.judges.grader.training import class_weights, train_grader
from racines_models.pictures import pick_columns
from racines_models.sample import take_sample
from racines_models.scores.scoring import Scorer, ScoresConfig
from racines_models.studies.realism.report import RealismConfig, choose_rows
from tests.models.judges.test_grader import SHORT, run
from tests.models.labelled import LabelledStore

ORGAN = ("KLX", "KSX", "GB", "Random")


@pytest.fixture(scope="module")
def organ() -> LabelledStore:
    store = LabelledStore(trajectories=20, length=8)
    store.labels = ORGAN
    store.views = store.views % 4
    store.grades[store.views == 3] = 0.0
    return store


@pytest.fixture(scope="module")
def folder(organ, tmp_path_factory):
    folder = tmp_path_factory.mktemp("grader")
    train_grader(organ, SHORT, run(folder))
    return folder


def test_heads_weights_and_report_have_the_organs_labels(organ, folder):
    grader = Grader.load(folder)
    assert grader.labels == ORGAN
    probabilities, _ = grader.probabilities_and_grade(organ.images[:3])
    assert probabilities.shape == (3, 4)
    assert class_weights(organ, 0.5).shape == (4,)
    told = examine(grader, organ).content
    assert set(told["views"]) == set(ORGAN)
    assert told["confusion"]["labels"] == list(ORGAN)
    assert torch.tensor(told["confusion"]["counts"]).shape == (4, 4)
    # Grades of Random, label 3 here, count in no figure of views.
    random = int((organ.views[organ.split_indices("test")] == 3).sum())
    assert told["metrics"]["grade_mae"]["n"] == told["metrics"]["grade_mae_all"]["n"] - random


def test_a_grader_of_old_is_cardiac(folder, tmp_path):
    network = GraderNetwork(32, 0.125)
    Grader(network, SHORT).save(tmp_path)
    path = tmp_path / "config.json"
    described = json.loads(path.read_text())
    assert described.pop("labels") == list(LABELS)
    path.write_text(json.dumps(described))
    assert Grader.load(tmp_path).labels == LABELS
    assert json.loads((folder / "config.json").read_text())["labels"] == list(ORGAN)


def test_a_grader_refuses_a_dataset_of_other_views(organ, folder):
    heart = LabelledStore(trajectories=10, length=6)
    grader = Grader.load(folder)
    with pytest.raises(RacinesError, match=r"KLX.*A4C.*train a grader"):
        examine(grader, heart)
    sample = take_sample(heart, "test", 8)
    judge = Scorer(ScoresConfig(), heart, sample, [sample.frames.images], None, None)
    with pytest.raises(RacinesError, match="the dataset has A4C"):
        judge.agreement(grader)
    mine = take_sample(organ, "test", 8)
    judge = Scorer(ScoresConfig(), organ, mine, [mine.frames.images], None, None)
    assert judge.agreement(grader)["view_agreement"]["n"] == 8


def test_realism_refuses_the_frames_of_another_organ(organ):
    with pytest.raises(RacinesError, match="A4C: the dataset's views are KLX"):
        choose_rows(organ, RealismConfig())
    assert len(choose_rows(organ, RealismConfig(view="GB", frames=4))) == 4


def test_the_strip_of_pictures_shows_each_view_of_the_organ(organ):
    columns = pick_columns(organ.views, organ.grades, len(ORGAN) - 1)
    assert set(organ.views[columns[:3]].tolist()) == {0, 1, 2}
