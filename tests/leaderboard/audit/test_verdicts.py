"""What an audit says of a whole record, what it exits with, and what is kept of it."""

import json
import math
import shutil
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from typer.testing import CliRunner

from racines_data.errors import RacinesError
from racines_data.store.frames import open_store
from racines_leaderboard.audit.bench import Bench, Places
from racines_leaderboard.audit.run import audit
from racines_leaderboard.audit.verdicts import (
    FAILS,
    UNKNOWN,
    Report,
    Verdict,
    fails,
    holds,
    unknown,
)
from racines_leaderboard.board.recompute import recompute
from racines_leaderboard.cli.command import app
from racines_leaderboard.records.schema import check, read_json, sealed
from racines_leaderboard.records.verdicts import (
    DOES_NOT_HOLD,
    FILE,
    HOLDS,
    NOT_VERIFIED,
    Audited,
    keep_verdicts,
    read_verdicts,
    verdict_of,
)
from racines_models.exchange.predictions.file import Task, write_predictions
from racines_models.sample import take_sample
from tests.leaderboard.audit.conftest import RESULTS
from tests.leaderboard.conftest import generator_scores
from tests.leaderboard.handed_in import inbox, submitted
from tests.models.labelled import Replay

MADE = {"road": "run", "agreement": "bitwise", "from": "the weights"}


def report(*verdicts: Verdict, made: dict | None = None) -> Report:
    return Report("tiny", "generators", "mine", "", verdicts, MADE if made is None else made)


@pytest.mark.parametrize(
    ("verdicts", "made", "whole"),
    [
        ((holds("metrics.ssim.value", "equal"),), MADE, HOLDS),
        ((), {}, NOT_VERIFIED),
        ((holds("seal", "equal"),), {}, NOT_VERIFIED),
        ((holds("seal", "equal"),), {"road": "run"}, NOT_VERIFIED),
        ((unknown("metrics.ssim", "no data"),), MADE, NOT_VERIFIED),
        ((unknown("metrics.recall.low", "the full weights would tell"),), MADE, HOLDS),
        ((unknown("by_seed.0.ssim", "no data"),), MADE, NOT_VERIFIED),
        ((unknown("metrics", "no data"),), MADE, NOT_VERIFIED),
        ((unknown("extractors.grader", "not here"),), MADE, NOT_VERIFIED),
        ((unknown("metrics.ssim", "no data"), fails("seal", "another")), {}, DOES_NOT_HOLD),
        ((fails("metrics.recall.low", "off"),), MADE, DOES_NOT_HOLD),
    ],
)
def test_what_a_record_comes_to(verdicts, made, whole):
    assert report(*verdicts, made=made).verdict == whole


def test_an_invented_record_does_not_hold_and_is_never_verified(judged):
    """SSIM 5 and FID -50 are refused at reading; what could be is not verified without scoring."""
    record = json.loads(judged.read_text())
    for key, value in (("ssim", 5.0), ("fid", -50.0)):
        metric = {"value": value, "low": value - 0.1, "high": value + 0.1, "n": 256}
        invented = json.loads(json.dumps(record))
        invented["scores"]["metrics"][key] = metric
        judged.write_text(json.dumps(sealed(invented)))
        found = audit(judged, Bench("tiny", Places()))
        assert found.verdict == DOES_NOT_HOLD
        assert any("beyond what it can be" in each.reason for each in found.verdicts)
    # All of it invented, of nothing that is here, and nobody handed anything in.
    scores = generator_scores("dream", record["scores"]["dataset"]["recipe_digest"], ssim=0.99)
    dream = {"schema": "racines.record/1", "board": "tiny", "track": "generators"}
    dream |= {"name": "dream", "tier": "self-reported", "submission": None, "scores": scores}
    path = judged.with_name("dream.json")
    path.write_text(json.dumps(sealed(dream)))
    found = audit(path, Bench("tiny", Places()))
    assert not found.holds
    assert {e.verdict for e in found.verdicts if e.subject.startswith("metrics.ssim")} >= {UNKNOWN}
    dream["tier"] = "reproduced"
    path.write_text(json.dumps(sealed(dream)))
    found = audit(path, Bench("tiny", Places()))
    assert found.tier == "self-reported"
    assert "tier" in {each.subject for each in found.verdicts if each.verdict == FAILS}


def test_a_tier_that_rests_on_an_invented_training(judged):
    record = json.loads(judged.read_text())
    keys = ("seeds", "metrics", "weights", "code", "environment")
    again = {key: json.loads(json.dumps(record["scores"][key])) for key in keys}
    record |= {"tier": "reproduced", "reproduced": again}
    judged.write_text(json.dumps(sealed(record)))
    assert audit(judged, Bench("tiny", Places()), quick=True).verdict == NOT_VERIFIED
    found = audit(judged, Bench("tiny", Places()))
    assert found.holds and found.tier == "reproduced", found.open
    inside = record["scores"]["metrics"]["ssim"]["high"]
    again["metrics"]["ssim"] |= {"value": inside}
    judged.write_text(json.dumps(sealed(record)))
    found = audit(judged, Bench("tiny", Places()))
    assert {e.subject for e in found.verdicts if e.verdict == FAILS} == {"reproduced.ssim.value"}


def test_a_record_that_says_how_tolerant_to_be_is_not_believed(judged):
    """A claim of many or of one item, or of a vast value, does not widen what passes."""
    record = json.loads(judged.read_text())
    record["scores"]["environment"]["cpu"] = "another"
    metric = record["scores"]["metrics"]["diversity_truth"]
    metric |= {"value": metric["value"] * 50, "low": None, "high": None, "n": 1}
    judged.write_text(json.dumps(sealed(record)))
    found = audit(judged, Bench("tiny", Places()))
    wrong = {each.subject for each in found.verdicts if each.verdict == FAILS}
    assert "metrics.diversity_truth.value" in wrong


def run(*words: str) -> tuple[int, str]:
    done = CliRunner().invoke(app, ["audit", *words])
    return done.exit_code, done.stdout


def test_the_command_exits_by_the_gravest_verdict(judged):
    code, out = run("--all")
    assert code == 0 and "holds" in out
    code, out = run("--all", "--quick")
    assert code == 3 and "NOT VERIFIED" in out
    assert "to verify: racines audit generators/mean-image --board tiny" in out
    record = json.loads(judged.read_text())
    record["seal"] = "0" * 64
    judged.write_text(json.dumps(record))
    assert run("--all", "--quick")[0] == 1


def test_a_board_finds_the_data_of_its_recipe(judged, tiny_root):
    Path("data/racines").unlink()
    assert run("--all")[0] == 3
    shutil.copytree(tiny_root, "data/by-another-name")
    assert run("--all")[0] == 0
    shutil.move("data/by-another-name", "far")
    code, out = run("--all", "--json")
    assert code == 3
    (told,) = json.loads(out)["reports"]
    assert told["remedies"][0] == "racines data build --params params.yaml --out data/tiny"
    assert run("--all", "--data", "nowhere", "--data", "far")[0] == 0


def test_verdicts_are_kept_beside_the_board_and_speak_of_that_record_alone(judged):
    record = json.loads(judged.read_text())
    assert verdict_of(record, RESULTS) is None
    assert run("--all", "--keep")[0] == 0
    check(json.loads((RESULTS / "tiny" / FILE).read_text()), "verdicts", FILE)
    kept = verdict_of(read_json(judged, "record"), RESULTS)
    assert kept == Audited(HOLDS, record["seal"], "self-reported", "bitwise")
    record["scores"]["metrics"]["ssim"]["value"] += 1e-9
    assert verdict_of(sealed(record), RESULTS) is None
    # With the seal of the record that was audited it is none either.
    assert verdict_of(record, RESULTS) is None
    judged.write_text(json.dumps(sealed(record)))
    assert run("--all", "--keep")[0] == 1
    assert getattr(verdict_of(sealed(record), RESULTS), "verdict", None) == DOES_NOT_HOLD
    judged.unlink()
    assert read_verdicts(keep_verdicts(RESULTS / "tiny", {}).parent) == {}


def test_a_sum_in_another_order_is_rounding_and_no_false_claim(judged):
    """Processors of one name sum in orders of their own; what is claimed beyond that is wrong."""
    record = json.loads(judged.read_text())
    ssim = record["scores"]["metrics"]["ssim"]
    last_bit = math.nextafter(ssim["value"], 1.0)
    told = {}
    for value in (last_bit, last_bit + 1e-11):
        ssim["value"] = value
        judged.write_text(json.dumps(sealed(record)))
        found = audit(judged, Bench("tiny", Places()))
        wrong = {each.subject for each in found.verdicts if each.verdict == FAILS}
        told[value] = found.made_again["agreement"], "metrics.ssim.value" in wrong
    assert list(told.values()) == [("rounding", False), ("bitwise", True)]


@pytest.mark.parametrize("text", ["{", "[]", '{"schema": "racines.verdicts/1"}'])
def test_a_damaged_file_of_verdicts_is_named(judged, text):
    (RESULTS / "tiny" / FILE).write_text(text)
    with pytest.raises(RacinesError, match=f"tiny/{FILE}"):
        verdict_of(json.loads(judged.read_text()), RESULTS)


def test_the_truth_handed_in_never_holds(ground):
    """A lookup of the truth comes out again as it was scored; its likeness gives it away."""
    store, root = open_store(ground.data), Path.cwd()
    sample = take_sample(store, "test", 16)
    path = inbox(root, "in") / "drawn.parquet"
    truth: Any = Replay(store)
    truth.card = SimpleNamespace(stochastic=False, conditional=True)
    write_predictions(path, Task(store, sample, "test", (0,)), truth, "truth")
    folder = submitted(root, "predictions", path, store.manifest["digest"])
    recompute(folder, ground, RESULTS)
    found = audit(RESULTS / "tiny/generators/mine.json", Bench("tiny", Places()))
    assert found.made_again["agreement"] == "bitwise"
    assert found.verdict == NOT_VERIFIED, [e for e in found.verdicts if e.verdict == FAILS]
    assert {each.subject for each in found.open} == {"truth.ssim", "truth.psnr"}
    assert found.remedies[-1].endswith("--secret")


def test_what_is_nearer_to_the_truth_than_the_truth_drawn_again(judged):
    record = json.loads(judged.read_text())
    ceiling = json.loads(json.dumps(record))
    ceiling["name"] = ceiling["scores"]["generator"] = "noise-ceiling"
    ceiling["submission"] = None
    metric = record["scores"]["metrics"]["ssim"]
    for moved, whole in ((0.1, HOLDS), (-0.1, NOT_VERIFIED)):
        far = {key: metric[key] + moved for key in ("value", "low", "high")}
        ceiling["scores"]["metrics"]["ssim"] = metric | far
        judged.with_name("noise-ceiling.json").write_text(json.dumps(sealed(ceiling)))
        assert audit(judged, Bench("tiny", Places())).verdict == whole
