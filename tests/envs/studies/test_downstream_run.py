"""The study of what servos learn: the command, that it goes on, and points that were published."""

import json
from dataclasses import replace

import pytest
from typer.testing import CliRunner

from racines_data.config import fill, read_params
from racines_data.errors import RacinesError
from racines_data.files import locked
from racines_envs.studies.downstream import run as module
from racines_envs.studies.downstream.config import METRICS, DownstreamConfig
from racines_envs.studies.downstream.correlation import SCORE, add_scores
from racines_envs.studies.downstream.points import open_point, open_points
from racines_envs.studies.downstream.run import measure_points, point_file
from racines_leaderboard.cli.command import app
from tests.conftest import ROOT

TINY = {
    "patients": 1, "lessons": "{frames: 20, places: 1}", "images": 128, "judged": 1, "starts": 1,
    "read": 1, "views": "[A4C]", "widths": "[8, 8, 16, 16, 16]",
}  # fmt: skip


def study(out, *points, workers="1"):
    settings = [word for name, each in TINY.items() for word in ("--set", f"{name}={each}")]
    words = ["study", "downstream", *points, *settings, "--out", str(out), "--workers", workers]
    result = CliRunner().invoke(app, [*words, "--profile", "smoke", "--json"])
    assert result.exit_code == 0, result.output
    return json.loads(result.stdout)


def made_up(point, config, folder):
    """Return metrics that cost nothing: by the label's length."""
    worth = {name: {"value": better * len(point.label)} for name, better in METRICS.items()}
    return worth, {name: [each["value"]] for name, each in worth.items()}


@pytest.mark.thorough
def test_a_study_goes_on_and_takes_new_points(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "score_images", made_up)
    monkeypatch.setattr(module, "true_extractor", lambda asked, folder: None)
    first = study(tmp_path, "truth")
    assert [each["label"] for each in first["points"]] == ["truth"]
    assert first["correlations"] == [] and SCORE not in first["points"][0]["metrics"]
    measured, real = [], module._measure
    monkeypatch.setattr(
        module, "_measure", lambda state, spec: measured.append(spec) or real(state, spec)
    )
    more = study(tmp_path, "scout-mean", "whole=truth")
    assert (
        measured == ["scout-mean"]
        and more["points"][1]["label"] == "whole"
        and more["points"][1]["found"] == first["points"][0]["found"]
    )
    assert {each["metrics"][SCORE]["value"] for each in more["points"]} == {0.0, 1.0}
    for name in ("downstream.json", "downstream.md", "downstream.png"):
        assert (tmp_path / name).stat().st_size > 300
    assert not [path for path in (tmp_path / "points").iterdir() if path.is_dir()]


def test_published_points_are_those_of_the_profile(tmp_path):
    """Each file is one that the study asks for, and holds what it takes."""
    settings = fill(DownstreamConfig, read_params(profile="reference")["downstream"], "downstream")
    published = ROOT / "docs/results/downstream"
    asked = {point_file(p, settings, tmp_path).name: p for p in open_points(settings.points)}
    files = {path.name for path in published.glob("*.json")}
    assert files and files <= asked.keys()
    specs = tuple(asked[name].spec for name in sorted(files))
    config = replace(settings, points=specs, published=str(published))
    rows = measure_points(config, tmp_path)
    add_scores(rows, config.anchors)
    assert [row["spec"] for row in rows] == list(specs)
    assert all(0.0 <= row["outcome"]["success_declared"]["value"] <= 1.0 for row in rows)
    assert not list(tmp_path.iterdir())


def test_two_studies_do_not_share_a_folder(tmp_path, monkeypatch):
    monkeypatch.setattr("racines_envs.cli.downstream.AT_ONCE", 0.1)
    with locked(tmp_path):
        done = CliRunner().invoke(app, ["study", "downstream", "truth", "--out", str(tmp_path)])
    assert done.exit_code == 1 and "another process has been writing there" in " ".join(
        str(done.exception).split()
    )
    assert not list(tmp_path.iterdir())


def test_points_that_were_published_are_not_measured_again(tmp_path, monkeypatch):
    config = DownstreamConfig(points=("truth",), published=str(tmp_path))
    monkeypatch.setattr(module, "_prepare", None)  # nobody is examined
    path = point_file(open_point("truth"), config, tmp_path)
    published, own = tmp_path / path.name, tmp_path / "own"
    told = dict.fromkeys(module.KEYS, 0) | {"schema": module.SCHEMA, "spec": "truth"}
    told |= {"kind": "truth", "weights": {}}
    published.write_text(json.dumps(told))
    assert measure_points(config, own) == [told | {"label": "truth"}]
    named = replace(config, points=("mine=truth",))
    assert measure_points(named, own) == [told | {"label": "mine"}]
    remedy = "get it again, or leave downstream.published empty"
    lacking = {key: value for key, value in told.items() if key != "metrics"}
    for damage, said in (
        ("{", "not readable as JSON"), ("[]", "not a result of 'truth'"),
        (json.dumps(told | {"spec": "cgan"}), "not a result of 'truth'"),
        (json.dumps(told | {"weights": {"w": "0"}}), "not a result of 'truth'"),
        (json.dumps(lacking), "not a result of 'truth'"),
    ):  # fmt: skip
        published.write_text(damage)
        with pytest.raises(RacinesError, match=f"{path.name}: {said}: {remedy}"):
            measure_points(config, own)
    mine = point_file(open_point("truth"), config, own)
    mine.parent.mkdir(parents=True)
    mine.write_text("{")
    with pytest.raises(RacinesError, match=f"{path.name}: not readable as JSON: remove it"):
        measure_points(config, own)
    with pytest.raises(RacinesError, match=r"downstream.published: .*: no such folder"):
        measure_points(replace(config, published=str(own / "nowhere")), tmp_path / "other")


@pytest.mark.thorough
def test_a_study_is_the_same_with_two_workers(tmp_path):
    points = ("truth", "scout-mean")
    documents = [study(tmp_path / n, *points, workers=n) for n in ("1", "2")]
    for each in documents:
        assert all(row["metrics"]["kid"]["value"] is not None for row in each["points"])
        for row in each["points"]:
            del row["seconds"], row["training_seconds"]
    assert documents[0]["points"] == documents[1]["points"]
