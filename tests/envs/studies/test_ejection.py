"""Ejection fractions at found views: volumes of a beat, whose error is whose, refusals."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from typer.testing import CliRunner

from racines_data.errors import RacinesError
from racines_envs.evaluation.patients import start_set
from racines_envs.studies import ejection as module
from racines_envs.studies.ejection import Beat, EjectionConfig, draw_ejection, study_ejection
from racines_envs.worlds.ward import make_ward
from racines_leaderboard.cli.command import app
from racines_models.judges.segmentation.model import SegmentationJudge
from racines_models.studies.sim_to_real.ejection import agreement

JUDGE = "models/weights/phantom-patients/segmentation"
LONG = np.array([90.0])
QUICK = EjectionConfig(split="validation", patients=2)


def test_a_beat_is_its_largest_and_smallest_ventricle():
    beat = 80.0 + 30.0 * np.cos(np.linspace(0.0, 2.0 * np.pi, 25, endpoint=False))
    blip, gone, half = beat.copy(), beat.copy(), beat.copy()
    blip[12] = 3.0  # one picture in which hardly anything is seen
    gone[:13] = np.nan
    half[3] = np.nan
    full, empty = module._extremes(np.stack([beat, blip, gone, half]))
    assert np.allclose(full[[0, 1]], beat[[1]], atol=0.1) and np.isnan([full[2], empty[2]]).all()
    assert np.allclose(empty[:2], beat.min()), "one odd picture does not count"
    assert np.isfinite([full[3], empty[3]]).all()
    assert np.allclose(Beat(np.array([120.0]), np.array([48.0]), LONG).fraction, 60.0)


def test_errors_are_told_by_what_they_are_from():
    truth = Beat(np.full(4, 100.0), np.full(4, 40.0), np.full(4, 90.0))  # 60 %

    def of(fraction: list[float]) -> list[Beat]:
        return [Beat(np.full(4, 100.0), 100.0 - np.array(fraction), np.full(4, 90.0))]

    measured = {
        ("agent", "judge"): of([50.0, 50.0, 50.0, np.nan]),
        ("agent", "truth"): of([54.0, 54.0, 54.0, 54.0]),
        ("planner", "judge"): of([52.0] * 4),
        ("planner", "truth"): of([57.0] * 4),
    }
    found = module._errors(measured, truth)
    assert found == {"total": 10.0, "geometry": 3.0, "view": 3.0, "segmentation": 4.0}
    several = agreement(np.array([[1.0, 2.0, 3.0, np.nan], [2.0, 2.0, 4.0, 4.5]]),
                        np.array([1.0, 2.0, 3.0, 4.0]), "mL")  # fmt: skip
    assert several["patients"] == 7 and several["not_seen"] == 1
    assert several["bias"]["value"] == pytest.approx((0.0 + 0.625) / 2)


def test_foreshortening_is_the_part_of_the_long_axis_that_the_plane_misses():
    truth = Beat(np.full(4, 100.0), np.full(4, 40.0), np.array([80.0, 90.0, 100.0, 90.0]))
    short = np.array([[72.0, 81.0, 90.0, np.nan], [80.0, 90.0, 100.0, 90.0]])
    own = [truth._replace(length=each) for each in short]
    told = module._foreshortening(own, truth, np.arange(4))
    assert told["not_seen"] == 1 and told["patients"] == 7 and "correlation" not in told
    assert told["bias"]["value"] == pytest.approx(-5.0), (
        "a tenth in one training, none in the other"
    )


def test_the_planners_true_outlines_measure_what_is_true():
    judge = SegmentationJudge.load(JUDGE)
    report, measured, truth = study_ejection("planner", Path(), QUICK, judge)
    ward = make_ward("beating", "validation", 2)
    true = [ward.pool.measures(row) for row in range(2)]
    assert np.allclose(truth.full, [each.volumes["lv"][0] for each in true])
    assert np.allclose(truth.fraction / 100, [each.ejection_fraction for each in true], atol=0.02)
    plane = measured["planner", "truth"][0]
    assert np.allclose(plane.full, truth.full, rtol=0.3)
    assert np.abs(plane.fraction - truth.fraction).max() < 15.0
    assert np.allclose(truth.length, [each.lv_length[0] for each in true])
    assert np.allclose(plane.length, truth.length, rtol=0.15)
    told = report["foreshortening"]
    assert told["agent"] == told["planner"] and told["planner"]["patients"] == 2
    own = module._nominal(start_set(QUICK), lambda: ward, judge)["length"] / truth.length
    assert ((own > 0.93) & (own < 1.01)).all(), "the ruler itself is a little short, no more"
    for outlines in ("truth", "judge"):
        one, other = measured["agent", outlines][0], measured["planner", outlines][0]
        assert np.array_equal(one.full, other.full), "the agent is the planner"
    assert report["errors"]["view"] == 0.0 and report["found_and_declared"] == 1.0
    assert json.loads(json.dumps(report)) == report
    assert draw_ejection(report, measured, truth)[:4] == b"\x89PNG"
    parts = study_ejection("planner", Path(), EjectionConfig(patients=2, chunk=1), judge)[1]
    apart, whole = parts["planner", "judge"][0], measured["planner", "judge"][0]
    assert np.array_equal(apart.empty, whole.empty), "however patients are cut to chunks"
    size = ward.pool.pixel_size(torch.arange(2))
    assert bool(((size > 0.6) & (size < 2.5)).all())


def test_what_has_no_ejection_fraction_is_refused(tmp_path):
    judge = SegmentationJudge.load(JUDGE)
    for view in ("A4C-patients", "PL-beating"):
        with pytest.raises(RacinesError, match="measured in A4C of beating hearts"):
            study_ejection("planner", Path(), EjectionConfig(view=view, patients=1), judge)
    words = ["study", "ejection", "planner", "--patients", "1", "--segmentation", str(tmp_path)]
    with pytest.raises(RacinesError, match="no segmentation judge there"):
        CliRunner().invoke(app, words, catch_exceptions=False)


@pytest.mark.thorough
def test_a_study_that_was_killed_goes_on_training_by_training(tmp_path, monkeypatch):
    judge, keep = SegmentationJudge.load(JUDGE), tmp_path / "parts.json"
    config = EjectionConfig(patients=2, chunk=1)
    whole, measured, truth = study_ejection("planner", Path(), config, judge)
    held, done = module._held, []

    def counted(*rest):
        done.append(rest)
        if len(done) == stop:
            raise KeyboardInterrupt
        return held(*rest)

    monkeypatch.setattr(module, "_held", counted)
    stop = 4  # the planner's part of the second patient
    with pytest.raises(KeyboardInterrupt):
        study_ejection("planner", Path(), config, judge, None, None, keep)
    names = list(json.loads(keep.read_text())["parts"])
    assert names == [
        "agent, training 0, patients 10000 to 10000",
        "planner, training 0, patients 10000 to 10000",
        "truth, patients 10000 to 10000",
        "nominal, patients 10000 to 10000",
        "agent, training 0, patients 10001 to 10001",
    ]
    done, stop, through = [], 0, []
    report, again, true = study_ejection(
        "planner", Path(), config, judge, None, through.append, keep
    )
    assert len(done) == 1, "the one part that was not done"
    assert through == [1, 1]
    for key, own in measured.items():
        for one, other in zip(own, again[key], strict=True):
            assert np.array_equal(one, other, equal_nan=True)
    assert np.array_equal(truth, true)
    apart = {key for key in whole if whole[key] != report[key]}
    assert apart <= {"seconds"}
    with pytest.raises(RacinesError, match=r"parts\.json: holds another study"):
        other = EjectionConfig(patients=1, chunk=1)
        study_ejection("planner", Path(), other, judge, None, None, keep)
    assert len(json.loads(keep.read_text())["parts"]) == 8, "and stays as it was"
    before = json.loads(keep.read_text())["parts"]
    beat = before["agent, training 0, patients 10000 to 10000"]
    beat["judge.full"][0] = None  # as a beat that was not measured is kept
    keep.write_text(json.dumps(json.loads(keep.read_text()) | {"parts": before}))
    unseen = study_ejection("planner", Path(), config, judge, None, None, keep)[0]
    assert unseen["agreement"]["agent, judge"]["ejection_fraction"]["not_seen"] == 1


def test_parts_are_gone_once_the_report_is_there(tmp_path):
    out = tmp_path / "e.json"
    parts = tmp_path / "e.parts.json"
    parts.write_text('{"study": "another"}')
    words = ["study", "ejection", "planner", "--patients", "1", "--segmentation", JUDGE]
    words += ["--out", str(out)]
    with pytest.raises(RacinesError, match="holds another study: give another --out, or --force"):
        CliRunner().invoke(app, words, catch_exceptions=False)
    assert parts.is_file() and not out.exists()
    done = CliRunner().invoke(app, [*words, "--force"], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    assert out.is_file() and out.with_suffix(".png").is_file() and not parts.exists()
