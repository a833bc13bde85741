"""The audit: what was left alone holds, and each way of tampering is caught by name."""

import copy
import json
import shutil
from pathlib import Path
from typing import Any

import pytest
import yaml
from typer.testing import CliRunner

from racines_data.files import sha256_file
from racines_data.store.frames import open_store
from racines_leaderboard.audit.bench import Bench, Places
from racines_leaderboard.audit.numbers import (
    BITWISE,
    HALF,
    TOLERANCE,
    agreement,
    bounds_by_metric,
    compare_numbers,
)
from racines_leaderboard.audit.roads import Road
from racines_leaderboard.audit.run import audit, retrain
from racines_leaderboard.audit.verdicts import FAILS, HOLDS, UNKNOWN, Report
from racines_leaderboard.cli.command import app
from racines_leaderboard.records.schema import check, sealed
from racines_leaderboard.records.verdicts import NOT_VERIFIED
from racines_models.exchange.onnx.generator import OnnxGenerator
from racines_models.exchange.predictions.file import Task, write_predictions
from racines_models.provenance import environment
from racines_models.published.places import CHECKOUT, WEIGHTS
from racines_models.sample import take_sample
from racines_models.scores.scoring import score
from tests.leaderboard.audit.conftest import SUBMISSIONS, record_a_trace
from tests.leaderboard.conftest import artefact
from tests.leaderboard.handed_in import CONFIG, inbox


def audited(path: Path, quick: bool = False) -> Report:
    return audit(path, Bench("tiny", Places()), quick)


def failing(report: Report) -> set[str]:
    return {each.subject for each in report.verdicts if each.verdict == FAILS}


def edit(path: Path, reseal: bool = True, **metrics: dict[str, Any]) -> None:
    """Change figures of a record, as somebody would who knows of the seal."""
    record = json.loads(path.read_text(encoding="utf-8"))
    for key, changes in metrics.items():
        record["scores"]["metrics"][key] |= changes
    path.write_text(json.dumps(sealed(record) if reseal else record), encoding="utf-8")


def swap_artefact(record_path: Path, new: Path) -> None:
    """Put another file in an artefact's place, with all hashes made to fit."""
    record = json.loads(record_path.read_text(encoding="utf-8"))
    folder = SUBMISSIONS / record["track"] / record["name"]
    (entry,) = record["submission"]["artefacts"]
    (folder / entry["path"]).write_bytes(new.read_bytes())
    entry |= artefact(entry["kind"], folder / entry["path"])
    record["scores"]["weights"] = {entry["path"]: entry["sha256"]}
    (folder / "submission.yaml").write_text(yaml.safe_dump(record["submission"]))
    record_path.write_text(json.dumps(sealed(record)), encoding="utf-8")


@pytest.mark.parametrize("name", ["drawn", "steered", "merged"])
def test_what_was_left_alone_holds_to_the_last_bit(name, request):
    path = request.getfixturevalue(name)
    report = audited(path)
    assert report.holds, failing(report)
    assert report.made_again["agreement"] == "bitwise"
    metrics = json.loads(path.read_text())["scores"]["metrics"]
    subjects = {each.subject for each in report.verdicts}
    for key in metrics:
        assert {f"metrics.{key}.{number}" for number in ("value", "low", "high", "n")} <= subjects


def test_a_metric_changed_by_a_thousandth(drawn):
    value = json.loads(drawn.read_text())["scores"]["metrics"]["ssim"]["value"]
    edit(drawn, ssim={"value": value + 0.001})
    assert failing(audited(drawn)) == {"metrics.ssim.value", "evidence.ssim"}


def test_a_metric_changed_by_a_thousandth_on_another_machine(drawn):
    record = json.loads(drawn.read_text())
    record["scores"]["environment"]["cpu"] = "another"
    ssim = record["scores"]["metrics"]["ssim"]
    drawn.write_text(json.dumps(sealed(record)))
    report = audited(drawn)
    assert report.holds and report.made_again["agreement"] == "tolerance"
    edit(drawn, ssim={"value": ssim["value"] + 0.001})
    assert failing(audited(drawn)) == {"metrics.ssim.value", "evidence.ssim"}


def test_weights_changed_by_one_byte(merged):
    path = Path("models/runs/mean-image/model.safetensors")
    content = bytearray(path.read_bytes())
    content[-1] ^= 1
    path.write_bytes(content)
    assert failing(audited(merged, quick=True)) == {"weights.model.safetensors"}


def test_an_artefact_changed_by_one_byte(steered):
    path = SUBMISSIONS / "agents/mine/trace.json"
    path.write_text(path.read_text().replace('"agent"', ' "agent"'))
    assert {"weights.trace.json", "submission"} <= failing(audited(steered, quick=True))


def test_predictions_for_another_version(drawn, monkeypatch):
    store = open_store("data/racines")
    monkeypatch.setitem(store.manifest, "digest", "ab" * 32)
    other = inbox(Path.cwd(), "other") / "drawn.parquet"
    task = Task(store, take_sample(store, "test", 16), "test", (0,))
    write_predictions(other, task, OnnxGenerator(Path("made/mine.onnx")), "stripes")
    swap_artefact(drawn, other)
    assert failing(audited(drawn, quick=True)) == {"artefacts.drawn.parquet"}
    assert "metrics" in failing(audited(drawn))


def test_a_record_of_another_version(drawn):
    record = json.loads(drawn.read_text())
    record["scores"]["dataset"]["recipe_digest"] = "cd" * 32
    drawn.write_text(json.dumps(sealed(record)))
    assert failing(audited(drawn, quick=True)) == {"dataset.recipe_digest"}


def test_a_trace_recorded_on_other_seeds(steered):
    swap_artefact(steered, record_a_trace((5, 6, 7), inbox(Path.cwd(), "other") / "trace.json"))
    assert failing(audited(steered, quick=True)) == {"artefacts.trace.json.start_set"}
    assert "metrics" in failing(audited(steered))
    record = json.loads(steered.read_text())
    record["scores"]["task"]["start_set"]["seeds"] = [5, 6, 7]
    steered.write_text(json.dumps(sealed(record)))
    assert "task.start_set" in failing(audited(steered, quick=True))


def test_a_swapped_extractor(drawn):
    record = json.loads(drawn.read_text())
    record["scores"]["extractors"]["inception"]["sha256"] = "ab" * 32
    drawn.write_text(json.dumps(sealed(record)))
    report = audited(drawn)
    assert failing(report) == {"extractors.inception", "extractors.inception.settings"}


def test_the_graders_that_had_a_say_are_those_that_an_agents_record_names(climbed):
    report = audited(climbed)
    assert report.holds, (failing(report), report.open)
    again = {each.subject: each for each in report.verdicts if each.verdict == HOLDS}
    for subject in ("extractors.grader", "extractors.guide", "metrics.success_grader.value"):
        assert subject in again
    record = json.loads(climbed.read_text())
    record["scores"]["extractors"]["grader"]["sha256"] = "ab" * 32
    climbed.write_text(json.dumps(sealed(record)))
    said = {each.subject: each for each in audited(climbed).verdicts}
    for subject in ("extractors.grader", "metrics.success_grader"):
        assert said[subject].verdict == UNKNOWN
    assert said["metrics.success_true.value"].verdict == HOLDS
    shutil.rmtree("models/runs/grader")
    said = {each.subject: each for each in audited(climbed).verdicts}
    assert said["metrics.success_true"].reason == "the grader that it goes by is not here"


def test_a_grader_that_is_not_here_leaves_open_what_rests_on_it(guided):
    """Elsewhere than in a clone: what only the grader could tell is open, and a remedy names it."""
    record = json.loads(guided.read_text())
    record["scores"]["extractors"].pop("guide")  # as of an agent that goes by none
    guided.write_text(json.dumps(sealed(record)))
    bench, scores = Bench("tiny", Places()), copy.deepcopy(record["scores"])
    for metrics in (scores["metrics"], *scores["by_seed"].values()):
        del metrics["success_grader"]
    del scores["extractors"]
    road = Road("no weights", "it learns nothing", lambda: scores)
    Path("models/runs/grader").rename("elsewhere")
    report = audit(guided, bench, find=lambda record, bench: road)
    assert report.verdict == NOT_VERIFIED and not failing(report)
    sha256 = record["scores"]["extractors"]["grader"]["sha256"]
    audit_it = "racines audit agents/hill-climber --board tiny"
    named = f"grader.safetensors of sha256 {sha256}"
    assert report.remedies == (f"{audit_it} --grader FOLDER  # {named}",)
    said = {each.subject: each.verdict for each in report.verdicts}
    for group in ("metrics", "by_seed.0"):
        assert said[f"{group}.success_grader"] == UNKNOWN

    record["scores"]["by_seed"]["0"]["final_grade"]["settings"]["level"] = 0.9
    record["scores"]["extractors"]["grader"]["sha256"] = "ab" * 32
    guided.write_text(json.dumps(sealed(record)))
    report = audit(guided, bench, find=lambda record, bench: road)
    wrong = {"extractors.grader", "scores.by_seed.0.final_grade.settings.level"}
    assert wrong <= failing(report) and not report.remedies


def test_a_published_grader_is_found_from_any_folder(ground):
    bench, published = Bench("tiny", Places()), CHECKOUT / WEIGHTS / "grader"
    sha256 = sha256_file(published / "grader.safetensors")
    assert bench.judge("grader", sha256) == published
    assert bench.judge("grader", "ab" * 32) is None


def test_an_interval_made_with_another_n(drawn, steered):
    store = open_store("data/racines")
    fewer = CONFIG.__class__(samples=8, resamples=20, speed=False)
    told = score(OnnxGenerator(Path("made/mine.onnx")), store, fewer, "mine").content["metrics"]
    psnr = {key: told["psnr"][key] for key in ("low", "high")}
    edit(drawn, psnr=psnr)
    assert {"metrics.psnr.low", "metrics.psnr.high"} <= failing(audited(drawn))
    edit(drawn, psnr=psnr | {"n": 8})
    assert "metrics.psnr.n" in failing(audited(drawn, quick=True))
    record = json.loads(steered.read_text())["scores"]["metrics"]["success_true"]
    assert record["n"] == 12
    edit(steered, success_true={"low": record["low"] / 2, "high": record["high"] / 2})
    assert "evidence.success_true" in failing(audited(steered, quick=True))


def test_results_edited_after_the_fact(drawn, merged):
    first = drawn.read_text()
    edit(drawn, reseal=False, fid={"value": 0.0, "low": 0.0})
    assert failing(audited(drawn, quick=True)) == {"seal", "evidence.fid"}
    edit(drawn, fid={"value": 0.0, "low": 0.0})
    assert failing(audited(drawn, quick=True)) == {"evidence.fid"}, "a new seal hides nothing"
    assert {"metrics.fid.value", "metrics.fid.low"} <= failing(audited(drawn))
    drawn.write_text(first)
    assert audited(drawn).holds
    edit(merged, ssim={"value": 0.5, "low": 0.5})
    assert failing(audited(merged, quick=True)) == {"scores"}


@pytest.mark.parametrize(
    ("key", "number", "moved", "verdict"),
    [
        ("recall", "low", 0.009, HOLDS),
        ("recall", "low", 0.03, UNKNOWN),
        ("recall", "low", 0.05, FAILS),
        ("recall", "n", 1, FAILS),
        ("ssim", "value", 0.009, HOLDS),
        ("ssim", "value", 0.03, FAILS),
    ],
)
def test_a_half_precision_copy_speaks_against_what_it_can_tell(key, number, moved, verdict):
    metric = {"value": 0.9, "low": 0.86, "high": 0.94, "n": 512}
    said = metric | {number: metric[number] + moved}
    record = {"track": "generators", "scores": {"metrics": {key: said}}}
    made = {"metrics": {key: metric}}
    found = {each.subject: each.verdict for each in compare_numbers(record, made, HALF)}
    assert found.pop(f"metrics.{key}.{number}") == verdict
    assert set(found.values()) == {HOLDS}


@pytest.mark.parametrize(
    ("number", "moved", "verdict"),
    [
        ("low", 3e-14, HOLDS),
        ("high", -2e-13, HOLDS),
        ("low", 1e-6, FAILS),
        ("value", 3e-14, HOLDS),
        ("value", 1e-9, FAILS),
        ("n", 1, FAILS),
    ],
)
def test_values_and_ends_are_rounded_alone_where_bits_are_equal(number, moved, verdict):
    metric = {"value": 40.5, "low": 37.25, "high": 44.75, "n": 300, "settings": {}}
    said = metric | {number: metric[number] + moved}
    record = {"track": "agents", "scores": {"metrics": {"position_error": said}}}
    made = {"metrics": {"position_error": metric}}
    found = {each.subject: each.verdict for each in compare_numbers(record, made, BITWISE)}
    assert found.pop(f"metrics.position_error.{number}") == verdict
    assert set(found.values()) == {HOLDS}


@pytest.mark.parametrize(("apart", "wanted"), [(0.0, BITWISE), (1e-14, BITWISE), (1e-6, TOLERANCE)])
def test_whoever_differs_in_every_value_by_rounding_gains_no_tolerance(apart, wanted):
    figures = {"ssim": 0.7, "psnr": 22.5, "fid": 85.0, "kid": 0.08}
    here = {key: {"value": value} for key, value in figures.items()}
    there = {key: {"value": value * (1 + apart)} for key, value in figures.items()}
    scores = {"environment": environment(), "metrics": there}
    made = {"environment": environment(), "metrics": here}
    assert agreement({"scores": scores}, made, "run") == wanted


def test_what_is_computed_of_many_sums_and_what_explains_motion_are_rounded_too():
    metric = {"value": 85.0, "low": 80.0, "high": 90.0, "n": 300, "settings": {}}
    bounds = bounds_by_metric({"metrics": {"fid": metric, "psnr": metric}}, BITWISE, "motion")
    assert 0.0 < bounds["explained"] < bounds["psnr"] < bounds["fid"] < 1e-6
    for moved, verdict in ((85e-11, HOLDS), (1e-6, FAILS)):
        record = {
            "track": "generators",
            "scores": {"metrics": {"fid": metric | {"value": 85 + moved}}},
        }
        found = list(compare_numbers(record, {"metrics": {"fid": metric}}, BITWISE))
        assert found[0].verdict == verdict


def test_what_is_not_here_is_said_to_be_unknown(merged):
    shutil.rmtree("models/runs/mean-image")
    Path("data/racines").unlink()
    report = audited(merged)
    assert report.verdict == NOT_VERIFIED and not failing(report)
    assert report.remedies == (
        "racines data build --params params.yaml --out data/tiny",
        "racines audit generators/mean-image --board tiny",
    )
    said = {each.subject: each for each in report.verdicts}
    for subject in ("weights.model.safetensors", "dataset.digest", "metrics.ssim"):
        assert said[subject].verdict == UNKNOWN and said[subject].reason


def test_training_again_reaches_the_tier_only_if_it_holds(merged):
    record = json.loads(merged.read_text())
    assert record["tier"] == "self-reported"
    bench = Bench("tiny", Places())
    psnr = dict(record["scores"]["metrics"]["psnr"])
    own = Path("models/runs/scores/mean-image.json")
    kept = own.read_text(encoding="utf-8")
    own.unlink()
    edit(merged, psnr={key: psnr[key] + 9 for key in ("value", "low", "high")})
    report = retrain(merged, bench, Path("again"))
    assert failing(report) == {"reproduced.psnr"}
    assert json.loads(merged.read_text())["tier"] == "self-reported"
    edit(merged, psnr=psnr)
    own.write_text(kept, encoding="utf-8")
    report = retrain(merged, bench, Path("again"))
    assert report.holds, failing(report)
    record = json.loads(merged.read_text())
    assert record["tier"] == "reproduced" and record == sealed(record)
    assert record["reproduced"]["weights"] == record["scores"]["weights"]
    # The run's weights are here, and do not tell what another training of it gave.
    again = audited(merged)
    assert again.holds and again.tier == "reproduced", failing(again)


def test_the_command_reports_and_exits_by_what_it_found(drawn, merged, tmp_path):
    words = ["audit", "--all", "--quick", "--json"]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 3, done.output
    document = json.loads(done.stdout)
    check(document, "audit", "stdout")
    assert document["verdict"] == NOT_VERIFIED and not document["holds"]
    assert [each["name"] for each in document["reports"]] == ["mean-image", "mine"]
    edit(drawn, reseal=False, ssim={"n": 15})
    done = CliRunner().invoke(app, ["audit", "mine", "--quick", "--out", "report.md"])
    assert done.exit_code == 1 and "DOES NOT HOLD" in done.stdout
    page = Path("report.md").read_text(encoding="utf-8")
    assert "| seal | does not hold |" in page and "| metrics.ssim.n | does not hold |" in page
    assert CliRunner().invoke(app, ["audit", "nobody"]).exit_code == 1
    assert CliRunner().invoke(app, ["audit"]).exit_code == 2


def test_a_record_without_a_seal_gets_one_if_nothing_fails(drawn):
    record = json.loads(drawn.read_text())
    seal = record.pop("seal")
    drawn.write_text(json.dumps(record))
    words = ["audit", "generators/mine", "--quick", "--seal"]
    assert CliRunner().invoke(app, words).exit_code == 3
    assert json.loads(drawn.read_text())["seal"] == seal


def test_a_damaged_record_is_reported(drawn):
    drawn.write_text("{}")
    assert failing(audited(drawn)) == {"record"}
