"""Evidence beside a record: its figures follow from it, and it is of the items made again."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from racines_envs.evaluation.measures import by_seed_of, measure, values_of
from racines_leaderboard.audit.bench import Bench, Places
from racines_leaderboard.audit.evidence import _parts, compare_evidence
from racines_leaderboard.audit.leaves import compare_leaves
from racines_leaderboard.audit.numbers import check_metrics
from racines_leaderboard.audit.roads import FIRST, Made, Road
from racines_leaderboard.audit.run import audit
from racines_leaderboard.audit.verdicts import FAILS, RETRAINABLE, Report
from racines_leaderboard.records.schema import sealed
from racines_leaderboard.records.verdicts import NOT_VERIFIED
from racines_models.statistics import Evidence
from tests.conftest import ROOT

TRAININGS = 3
RUN = Path("models/runs/mean-image")


class Told:
    """A record whose figures are those of made-up evidence, and the same made again."""

    def __init__(self, path: Path, hours: float | None = 2.0) -> None:
        self.path, self.bench = path, Bench("tiny", Places())
        self.record = json.loads(path.read_text(encoding="utf-8"))
        scores, sample = self.record["scores"], self.bench.sample
        items, units = sample.frames.index.numpy(), sample.trajectory
        rng, self.values = np.random.default_rng(0), {}
        for key, metric in scores["metrics"].items():
            if key in ("ssim", "psnr", "pose_error_mm"):
                spread = rng.normal(0.0, 0.01, (TRAININGS, 1, len(items)))
                self.values[key] = metric["value"] + spread
        self.items, self.units = items, units
        one = {key: each[:1] for key, each in self.values.items()}
        self.first = Made(self.scores_of(one, 1), self.evidence_of(one))
        weights = dict(scores["weights"])
        for seed in range(1, TRAININGS):
            weights[f"seed-{seed}/model.safetensors"] = f"{seed}" * 64
        self.bench.settings["generators"] = {"mean-image": {}}
        self.record["scores"] = self.scores_of(self.values, TRAININGS) | {"weights": weights}
        self.record["submission"]["training"]["hours"] = hours
        if hours is None:
            del self.record["submission"]["training"]["hours"]
        folder = Path("leaderboard/submissions/generators/mean-image")
        (folder / "submission.yaml").write_text(json.dumps(self.record["submission"]))

    def evidence_of(self, values: dict[str, np.ndarray]) -> Evidence:
        evidence = Evidence()
        for key, each in values.items():
            evidence.add(key, "mean", each, self.items, self.units)
        return evidence

    def scores_of(self, values: dict[str, np.ndarray], runs: int) -> dict[str, Any]:
        figures = self.evidence_of(values).figures
        scores = json.loads(json.dumps(self.record["scores"]))
        # The set's own distances have no figures of each item here, and are those of the record.
        scores |= {"runs": runs, "seeds": list(range(runs))}
        for key, each in figures.items():
            old = scores["metrics"][key]
            rules = {k: v for k, v in old.get("settings", {}).items() if k != "trajectories"}
            rules.pop("interval", None)
            scores["metrics"][key] = each.interval().to_json(old.get("unit"), **rules)
        return scores

    def audit(self, evidence: Evidence, made: Made | None = None) -> Report:
        told = evidence.write(self.path.with_suffix(".parquet"))
        record = self.record | {"scores": self.record["scores"] | {"evidence": told}}
        return self.audit_as(record, made or self.first)

    def audit_as(self, record: dict[str, Any], made: Made) -> Report:
        self.path.write_text(json.dumps(sealed(record)))
        road = Road(FIRST, "the first of three", lambda: made, 1)
        return audit(self.path, self.bench, find=lambda *_: road)


def failing(report: Report) -> set[str]:
    return {each.subject for each in report.verdicts if each.verdict == FAILS}


@pytest.fixture
def several(judged, monkeypatch) -> Told:
    """Three trainings of which the first is here; all that ranks has figures of each item."""
    from racines_leaderboard.records import tracks

    # FID and KID of a few made-up frames have no figures of each: they are left aside here.
    ranked = tuple(key for key in tracks.GENERATORS.ranked_by if key not in ("fid", "kid"))
    monkeypatch.setitem(tracks.TRACK, "generators", replace(tracks.GENERATORS, ranked_by=ranked))
    return Told(judged)


def test_the_first_of_several_trainings_holds_and_the_others_are_retrainable(several):
    report = several.audit(several.evidence_of(several.values))
    assert report.holds, (failing(report), report.open)
    (further,) = [each for each in report.verdicts if each.verdict == RETRAINABLE]
    assert further.subject == "trainings" and "2 h" in further.reason
    assert "2 beyond the first" in further.reason


def test_trainings_without_their_hours_are_not_verified(judged, several):
    several.record["submission"]["training"].pop("hours")
    path = Path("leaderboard/submissions/generators/mean-image/submission.yaml")
    path.write_text(json.dumps(several.record["submission"]), encoding="utf-8")
    report = several.audit(several.evidence_of(several.values))
    assert report.verdict == NOT_VERIFIED and not failing(report)
    assert [each.subject for each in report.open] == ["trainings"]


def test_items_that_change_places_are_noticed_though_no_figure_changes(several):
    """As somebody would to win pairs: mean and interval of the first training stay."""
    values = {key: each.copy() for key, each in several.values.items()}
    unit = several.units == several.units[0]
    values["ssim"][0, 0, unit] = values["ssim"][0, 0, unit][::-1]
    report = several.audit(several.evidence_of(values))
    assert failing(report) == {"evidence.ssim.each"}


@pytest.mark.parametrize(
    "what", ["value", "low", "high", "n", "units", "trainings", "interval", "level"]
)
def test_a_figure_that_does_not_follow_from_the_evidence(several, what):
    metric = several.record["scores"]["metrics"]["ssim"]
    place = metric if what in metric else metric["settings"]
    place[what] = f"{place[what]}." if what == "interval" else place[what] * 1.0001
    if what in ("n", "units", "trainings"):
        place[what] = round(place[what]) + 1
    report = several.audit(several.evidence_of(several.values))
    assert any(each.startswith("evidence.ssim") for each in failing(report)), failing(report)


@pytest.mark.parametrize("name", ["ppo", "dqn", "ppo-image-a4c"])
def test_of_an_agents_trainings_the_first_alone_was_made_again(name):
    """Some start sets find the view more often than others: n and coverage are not the first's."""
    path = ROOT / f"leaderboard/results/phantom-reference/agents/{name}.json"
    record, evidence = json.loads(path.read_text()), Evidence.read(path.with_suffix(".parquet"))
    scores = json.loads(json.dumps(record["scores"]))
    measured, first = measure({key: each[:1] for key, each in values_of(evidence).items()})
    scores["metrics"] |= measured
    scores |= {"runs": 1, "by_seed": by_seed_of(first, scores["seeds"])}
    bench = Bench("phantom-reference", Places())
    assert not [each for each in compare_leaves(record, scores, {}, True) if each.verdict == FAILS]
    told = [*check_metrics(record, bench), *compare_evidence(record, evidence, first, {})]
    assert not [each for each in told if each.verdict == FAILS]


def test_evidence_of_other_frames_or_other_units(several):
    kept = several.evidence_of(several.values)
    for part, wrong in (("items", several.items + 1), ("units", several.units[::-1].copy())):
        other = Evidence(dict(kept.figures))
        other.figures["psnr"] = replace(kept.figures["psnr"], **{part: wrong})
        found = failing(several.audit(other))
        assert {"evidence.psnr.items", "evidence.psnr.each"} <= found


def test_evidence_that_is_gone_edited_or_damaged(several):
    beside, evidence = several.path.with_suffix(".parquet"), several.evidence_of(several.values)
    told = evidence.write(beside)
    record = several.record | {"scores": several.record["scores"] | {"evidence": told}}
    beside.unlink()
    assert failing(several.audit_as(record, several.first)) == {"record"}
    several.evidence_of({key: each + 1e-9 for key, each in several.values.items()}).write(beside)
    assert failing(several.audit_as(record, several.first)) == {"record"}
    beside.write_bytes(b"PAR1")
    told["sha256"] = "ab" * 32
    assert failing(several.audit_as(record, several.first)) == {"record"}
    told["file"] = "other.parquet"
    assert failing(several.audit_as(record, several.first)) == {"record"}


def test_a_metric_that_ranks_without_figures_of_each_item(several):
    values = {key: each for key, each in several.values.items() if key != "ssim"}
    assert "evidence.ssim" in failing(several.audit(several.evidence_of(values)))


def test_a_training_that_was_left_out_of_the_evidence(several):
    fewer = {key: each[:2] for key, each in several.values.items()}
    found = failing(several.audit(several.evidence_of(fewer)))
    assert "evidence.ssim.runs" in found


def test_without_figures_of_the_recomputed_items_it_is_not_verified(several):
    made = Made(several.first.scores, None)
    report = several.audit(several.evidence_of(several.values), made)
    assert report.verdict == NOT_VERIFIED and not failing(report)


def without(evidence: Evidence, name: str) -> None:
    del evidence.figures[name]


def shorter(evidence: Evidence, name: str) -> None:
    each = evidence.figures[name]
    evidence.figures[name] = replace(
        each, values=each.values[..., 1:], items=each.items[1:], units=each.units[1:]
    )


def of_nobody(evidence: Evidence, name: str) -> None:
    for key, each in evidence.figures.items():
        if each.units is not None:
            units = each.units.copy()
            units[0] = -5
            evidence.figures[key] = replace(each, units=units)


@pytest.mark.parametrize(
    ("record", "change", "name"),
    [
        ("patients/patient-agents/servo-a4c", without, "position_error"),
        ("patients/patient-agents/servo-a4c", shorter, "position_error"),
        ("patients/patient-agents/servo-a4c", of_nobody, ""),
        ("phantom-default/agents/ppo", without, "final_grade"),
        ("phantom-default/agents/ppo", shorter, "final_grade"),
    ],
)
def test_evidence_that_lacks_episodes_fails_and_nothing_breaks(record, change, name):
    path = ROOT / "leaderboard/results" / f"{record}.json"
    evidence = Evidence.read(path.with_suffix(".parquet"))
    assert _parts(json.loads(path.read_text()), evidence).verdict != FAILS
    change(evidence, name)
    assert _parts(json.loads(path.read_text()), evidence).verdict == FAILS
