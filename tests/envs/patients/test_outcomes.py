"""What is told of how episodes on patients end follows from the evidence beside the records."""

import json

import numpy as np
import pytest
from PIL import Image

from racines_data.views import VIEWS
from tests.envs.patients import outcomes
from tests.envs.patients.figures import TIERS, on_boards


@pytest.fixture(scope="module")
def found():
    return on_boards()


def test_shares_within_thresholds_rise_and_above_them_fall():
    figures, thresholds = np.array([1.0, 2.0, 2.0, 9.0]), np.array([0.0, 2.0, 10.0])
    assert outcomes.share_within(figures, thresholds, above=False).tolist() == [0.0, 75.0, 100.0]
    assert outcomes.share_within(figures, thresholds, above=True).tolist() == [100.0, 75.0, 0.0]


def test_the_published_tables_are_those_of_the_boards(found):
    told = json.loads(outcomes.RESULT.read_text(encoding="utf-8"))
    tables = told["tables"]
    for name, made in (
        ("aims", outcomes.aims(found, outcomes.ahead_of(tables))), ("ends", outcomes.ends(found)),
        ("pathology", outcomes.by_pathology(found)), ("never", outcomes.never()),
        ("left", outcomes.left()), ("secret", outcomes.secret()),
    ):  # fmt: skip
        assert tables[name] == made, f"python -m tests.envs.patients.outcomes: {name}"


def test_where_an_agent_always_fails_no_training_found_the_view():
    assert [outcomes.never_found("planner", view, "patients") for view in VIEWS] == [0] * len(VIEWS)
    for tier in TIERS:
        blind = outcomes.never_found("random", "A4C", tier)
        assert outcomes.never_found("servo", "A4C", tier) < blind <= 140


def test_pictures_are_drawn_of_all_trainings(tmp_path):
    counted = outcomes.draw_learning(tmp_path / "learning.png")
    assert set(counted.values()) == {3}
    outcomes.draw_thresholds(tmp_path / "thresholds.png")
    for path in tmp_path.glob("*.png"):
        assert min(Image.open(path).size) > 300


def test_scores_of_other_patients_or_weights_are_refused(tmp_path, found):
    best = outcomes.BEST["patients"]
    row = outcomes.BOARDS / f"patients/patient-agents/{best}-a4c.json"
    scores, path = json.loads(row.read_text(encoding="utf-8"))["scores"], tmp_path / "train.json"
    path.write_text(json.dumps(scores))
    with pytest.raises(ValueError, match="not of A4C of train patients"):
        outcomes.gap(path, found)
    scores["task"]["split"] = "train"
    path.write_text(json.dumps(scores))
    row = outcomes.gap(path, found)
    assert row[:2] == ["still", f"`{best}`"] and row[2] == row[3] and row[4] == "+0.0"
    assert outcomes.ahead_of({"gap": {"rows": [row]}}) == {"patients": 0.0}
    scores["weights"]["files"] = {"policy.safetensors": "0" * 64}
    path.write_text(json.dumps(scores))
    with pytest.raises(ValueError, match="of other weights"):
        outcomes.gap(path, found)
