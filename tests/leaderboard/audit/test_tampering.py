"""Ways of tampering with a record that was handed in, and with its seal: none of them holds."""

import copy
import json
from collections.abc import Callable
from typing import Any

import pytest

from racines_leaderboard.audit.verdicts import Report
from racines_leaderboard.records.schema import sealed
from tests.leaderboard.audit.test_leaves import Held

Record = dict[str, Any]


def scores(record: Record) -> dict[str, Any]:
    return record["scores"]


def metric(record: Record, key: str = "ssim") -> dict[str, Any]:
    return record["scores"]["metrics"][key]


def tell(container: Callable[[Record], dict[str, Any]], **changes: Any) -> Callable[[Record], None]:
    return lambda record: container(record).update(changes)


def shift(key: str, by: float) -> Callable[[Record], None]:
    """Move a whole interval, so that nothing contradicts itself."""

    def change(record: Record) -> None:
        for end in ("value", "low", "high"):
            metric(record, key)[end] += by

    return change


def swap(record: Record) -> None:
    ours = record["scores"]["metrics"]
    ours["ssim"], ours["ms_ssim"] = ours["ms_ssim"], ours["ssim"]


def widen(record: Record) -> None:
    for end, by in (("low", -0.2), ("high", 0.2)):
        metric(record)[end] += by


WAYS: dict[str, Callable[[Record], None]] = {
    "a better value": shift("ssim", 0.002),
    "a value beyond what it can be": tell(metric, value=5.0, low=4.9, high=5.1),
    "a distance below nothing": lambda r: tell(lambda r: metric(r, "fid"), value=-50.0)(r),
    "a lower distance": shift("fid", -0.5),
    "a lower distance of means": shift("kid", -0.001),
    "more decibels": shift("psnr", 0.1),
    "a wider interval": widen,
    "no interval": tell(metric, low=None, high=None),
    "more items": tell(metric, n=10_000),
    "no items": tell(metric, n=0),
    "no value": tell(metric, value=None, low=None, high=None),
    "two metrics changed places": swap,
    "another rule": lambda r: metric(r)["settings"].update(window="none"),
    "another range of gray": lambda r: metric(r)["settings"].update(data_range=1.0),
    "a metric left out": lambda r: r["scores"]["metrics"].pop("recall"),
    "a metric invented": lambda r: r["scores"]["metrics"].update(violations=metric(r)),
    "a judge's word invented": lambda r: r["scores"]["metrics"].update(grade_error=metric(r)),
    "other seeds": tell(scores, seeds=[7]),
    "more runs": tell(scores, runs=3),
    "other notes": tell(scores, notes=["The best there is."]),
    "other frames": lambda r: scores(r)["dataset"].update(sample="ab" * 32),
    "another split": lambda r: scores(r)["dataset"].update(split="train"),
    "other data": lambda r: scores(r)["dataset"].update(recipe_digest="ab" * 32),
    "data of another digest": lambda r: scores(r)["dataset"].update(digest="ab" * 32),
    "other extractors": lambda r: scores(r)["extractors"]["inception"].update(layer="first"),
    "no extractors": tell(scores, extractors={}),
    "other weights": lambda r: scores(r)["weights"].update({"mine.onnx": "ab" * 32}),
    "no weights": tell(scores, weights=None),
    "another name": tell(scores, generator="theirs"),
    "another board": lambda r: scores(r)["dataset"].update(board="theirs"),
    "a higher tier": lambda r: r.update(tier="reproduced"),
    "a lower tier": lambda r: r.update(tier="self-reported"),
    "nobody's submission": lambda r: r.update(submission=None),
    "another version of the code": lambda r: scores(r)["code"].update(version="9.9.9"),
    "a whole record of another name": lambda r: r.update(name="theirs"),
}


@pytest.fixture
def held(handed_in) -> Held:
    return Held(handed_in)


def wrong(report: Report) -> set[str]:
    return {each.subject for each in report.verdicts if each.verdict == "does not hold"}


def test_no_way_of_tampering_holds_sealed_again_or_not(held):
    assert held.audit(held.record).holds
    seal, passed = held.record["seal"], []
    for how, change in WAYS.items():
        again = held.changed(change)
        if not again.fails:
            passed.append((how, "sealed again", again.verdict))
        record = copy.deepcopy(held.record)
        change(record)
        for said in (seal, "0" * 64):
            held.path.write_text(json.dumps(record | {"seal": said}))
            report = held.audit_as_it_lies()
            if not report.fails:
                passed.append((how, said[:4], report.verdict))
    assert not passed
    assert len(WAYS) >= 24


def test_a_metric_that_nothing_here_makes_is_not_verified(held):
    report = held.changed(lambda r: r["scores"]["metrics"].update(realism=metric(r)))
    assert report.verdict == "not verified"
    assert [each.subject for each in report.open] == ["package.metrics.realism"]


def test_a_commit_that_is_an_option_of_git(held):
    for commit in ("--help", 5, "HEAD"):
        assert "code.commit" in wrong(
            held.changed(tell(lambda r: scores(r)["code"], commit=commit))
        )


def test_a_record_of_an_earlier_version_holds_and_a_false_version_does_not(held):
    def audited(version: object) -> Report:
        return held.changed(tell(lambda r: scores(r)["code"], version=version))

    report = audited("0.1.0")
    said = next(each for each in report.verdicts if each.subject == "code.version")
    assert report.holds and said.verdict == "informative" and said.claimed == "0.1.0"
    for version in ("1000.0.0", "", "newest"):
        assert "code.version" in wrong(audited(version))


def test_a_seal_that_is_gone_tells_nothing_and_hides_nothing(held):
    record = copy.deepcopy(held.record)
    del record["seal"]
    held.path.write_text(json.dumps(record))
    assert held.audit_as_it_lies().holds
    shift("ssim", 0.002)(record)
    held.path.write_text(json.dumps(record))
    assert "metrics.ssim.value" in wrong(held.audit_as_it_lies())
    held.path.write_text(json.dumps(sealed(held.record)))
    assert held.audit_as_it_lies().holds
