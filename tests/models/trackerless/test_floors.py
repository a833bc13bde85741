"""The floors, the sweeps they are asked about, and the record of their scores."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from typer.testing import CliRunner

from racines_data.errors import RacinesError
from racines_leaderboard.cli.command import app
from racines_models.protocol import Run
from racines_models.statistics import Evidence, write_scores
from racines_models.trackerless.floors import (
    ConstantMotion,
    ConstantMotionConfig,
    MeanMotion,
    NoMotion,
)
from racines_models.trackerless.motion import to_vectors
from racines_models.trackerless.protocol import check_unseen, estimator_class, open_estimators
from racines_models.trackerless.scoring import (
    MotionScoresConfig,
    asked,
    estimate_all,
    score_motion,
)
from racines_models.trackerless.sweeps import SweepSet
from tests.models.trackerless.sweeping import LENGTH, SWEEPS, SweptStore, recorded


@pytest.fixture(scope="module")
def sweeps() -> SweepSet:
    return SweepSet(SweptStore())


def scored(estimators: list, sweeps: SweepSet, **settings):
    config = MotionScoresConfig(**settings)
    motions = estimate_all(estimators, sweeps, asked(sweeps, config))
    return score_motion(estimators[0].name, motions, sweeps, config)


def test_no_motion_is_the_zero_of_the_score(sweeps):
    content = scored([NoMotion()], sweeps).content
    assert content["metrics"]["score"]["value"] == 0.0
    lengths = [each.motion.to_previous[1:, :3, 3].norm(dim=1).mean() for each in
               sweeps.sweeps("test")]  # fmt: skip
    told = content["metrics"]["step_mm"]
    assert told["value"] == pytest.approx(1e3 * float(torch.stack(lengths).mean()))
    assert told["n"] == SWEEPS["test"] and told["low"] < told["value"] < told["high"]
    assert content["counts"] == {"sweeps": 6, "frames": 6 * LENGTH, "left_out": 0}
    assert all(value == 0.0 for value in content["explained"].values())


def test_constant_motion_goes_on_as_the_sweep_began(sweeps):
    sweep = sweeps.sweeps("test")[0]
    found = ConstantMotion().estimate(sweeps.shown(sweep, told_first=True))
    assert torch.allclose(found.to_previous[1], sweep.motion.to_previous[1], atol=1e-9)
    assert torch.allclose(found.to_previous[5], found.to_previous[1], atol=1e-9)
    assert torch.allclose(found.to_first[2], found.to_previous[1] @ found.to_previous[1])
    prior = ConstantMotion(ConstantMotionConfig((0.001, 0.0, 0.0, 0.0, 0.0, 0.0)))
    assert ConstantMotion().told_first and not prior.told_first
    shifts = prior.estimate(sweeps.shown(sweep)).to_first[:, 0, 3]
    assert torch.allclose(shifts, torch.arange(LENGTH).double() * 1e-3)
    with pytest.raises(RacinesError, match="prior: 2 numbers: give six"):
        ConstantMotion(ConstantMotionConfig((0.1, 0.2)))


def test_who_is_not_told_the_first_motion_does_not_see_it(sweeps):
    sweep = sweeps.sweeps("test")[0]
    assert sweeps.shown(sweep).first is None
    seen = []

    class Looking(NoMotion):
        def estimate(self, shown):
            seen.append(shown.first)
            return super().estimate(shown)

    estimate_all([Looking()], sweeps, [sweep])
    assert seen == [None]


def test_mean_motion_is_that_of_the_training_sweeps(sweeps, tmp_path: Path):
    told = MeanMotion().fit(sweeps, Run(tmp_path, progress=False))
    steps = [to_vectors(each.motion.to_previous[1:]) for each in sweeps.sweeps("train")]
    mean = torch.cat(steps).mean(0)
    assert told["steps"] == SWEEPS["train"] * (LENGTH - 1)
    loaded = MeanMotion.load(tmp_path)
    found = loaded.estimate(sweeps.shown(sweeps.sweeps("test")[0]))
    assert torch.allclose(to_vectors(found.to_previous[1:]), mean.expand(LENGTH - 1, 6), atol=1e-8)
    check_unseen([loaded], sweeps, "test")
    with pytest.raises(RacinesError, match="mean-motion learned from the train split of these"):
        check_unseen([loaded], sweeps, "all")
    check_unseen([loaded], SweepSet(recorded_elsewhere()), "all")
    with pytest.raises(RacinesError, match="racines train motion mean-motion"):
        MeanMotion.load(tmp_path / "absent")


def recorded_elsewhere() -> SweptStore:
    store = recorded(SweptStore())
    store.manifest["digest"] = "another"
    return store


def test_scores_follow_from_the_figures_kept_beside_them(sweeps, tmp_path: Path):
    made = scored([NoMotion()], sweeps)
    content = write_scores(tmp_path / "a.json", made.content, made.evidence)
    assert json.loads((tmp_path / "a.json").read_text()) == json.loads(json.dumps(content))
    kept = Evidence.read(tmp_path / "a.parquet")
    names = {str(each.number): each.id for each in sweeps.sweeps("test")}
    items = kept.figures["gpe"].items
    assert items is not None and content["sweeps"] == names == {
        str(item): names[str(item)] for item in items
    }
    for name, metric in content["metrics"].items():
        again = kept.figures[name].interval()
        assert (again.value, again.low, again.high) == (
            metric["value"],
            metric["low"],
            metric["high"],
        )
    other = scored([NoMotion()], sweeps, landmarks=3)
    with pytest.raises(RacinesError, match=r"holds another result, of no-motion test .*--force"):
        write_scores(tmp_path / "a.json", other.content, other.evidence)


def test_millimetres_are_withheld_where_they_are_not_known():
    store = recorded(SweptStore())
    content = scored([NoMotion()], SweepSet(store), split="all").content
    assert set(content["metrics"]) == {"drift_mm", "step_mm", "drift_deg", "step_deg"}
    assert content["withheld"]["gpe"] == (
        "these data do not say where pixels lie: set pixel_mm or plane"
    )
    assert content["counts"]["sweeps"] == sum(SWEEPS.values())
    stated = scored([NoMotion()], SweepSet(store), pixel_mm=0.5).content
    assert stated["metrics"]["gpe"]["value"] > 0 and not stated["withheld"]
    nine = (-31.75, 0.0, 0.25, 0.5, 0.0, 0.0, 0.0, 0.0, 0.5)
    plane = scored([NoMotion()], SweepSet(store), plane=nine).content
    assert plane["metrics"]["gpe"]["value"] == pytest.approx(stated["metrics"]["gpe"]["value"])
    store.manifest = dict(store.manifest, scale="unknown")
    unscaled = scored([NoMotion()], SweepSet(store)).content
    assert set(unscaled["metrics"]) == {"drift_deg", "step_deg"}
    assert unscaled["withheld"]["drift_mm"] == "positions of these data have no metres"
    with pytest.raises(RacinesError, match="have no metres, so pixels in mm do not fit"):
        scored([NoMotion()], SweepSet(store), pixel_mm=0.5)


def test_units_are_patients_recordings_or_sweeps():
    def units(store: SweptStore) -> list[int]:
        return [each.unit for each in SweepSet(store).sweeps("test")]

    assert len(set(units(SweptStore()))) == 6
    assert len(set(units(recorded(SweptStore())))) == 2  # four sweeps a session
    store = SweptStore()
    store.patients = [20_000 + place // 3 for place in range(len(store.trajectories))]
    store.manifest = dict(store.manifest, recipe=None)
    assert set(units(store)) == {20_011, 20_012, 20_013}


def test_what_cannot_be_asked_is_refused(sweeps):
    known = MotionScoresConfig(pixel_mm=0.5)
    with pytest.raises(RacinesError, match="these data say where their pixels lie"):
        asked(sweeps, known)
    with pytest.raises(RacinesError, match="unknown split 'none'"):
        asked(sweeps, MotionScoresConfig(split="none"))
    with pytest.raises(RacinesError, match="give pixel_mm or plane, not both"):
        MotionScoresConfig(pixel_mm=0.5, plane=(0.0,) * 9)
    with pytest.raises(RacinesError, match="plane: .*give nine numbers"):
        MotionScoresConfig(plane=(1.0, 2.0))
    with pytest.raises(RacinesError, match="give steps of pixels"):
        MotionScoresConfig(plane=(0, 0, 0, 1.0, 0, 0, 1.0, 0, 0))
    with pytest.raises(RacinesError, match="pixel_mm 40: give mm"):
        MotionScoresConfig(pixel_mm=40.0)
    with pytest.raises(RacinesError, match="landmarks 0"):
        MotionScoresConfig(landmarks=0)
    store = SweptStore()
    store.parameters[:, 6:] = np.nan
    with pytest.raises(RacinesError, match="no sweep whose frames all have poses"):
        SweepSet(store)
    resting = SweptStore()
    resting.parameters[:] = resting.parameters[::LENGTH].repeat_interleave(LENGTH, 0)
    with pytest.raises(RacinesError, match="and whose probe moves"):
        SweepSet(resting)
    some = SweptStore()
    some.parameters[LENGTH : 2 * LENGTH] = some.parameters[LENGTH]
    some.parameters[3, 7] = np.nan
    some._splits["test"] = some._splits["test"][:1] * 2
    assert SweepSet(some).left_out == {"train": 2, "validation": 0, "test": 0, "all": 2}
    with pytest.raises(RacinesError, match="split test has no sweep"):
        SweepSet(some).sweeps("test")
    with pytest.raises(RacinesError, match="no-motoin"):
        estimator_class("no-motoin")
    with pytest.raises(RacinesError, match="no pair-cnn there; run: racines train motion pair-cnn"):
        open_estimators("pair-cnn", Path("absent"), {})


def test_transforms_of_another_shape_or_none_are_refused(sweeps):
    sweep = sweeps.sweeps("test")[0]

    class Short(NoMotion):
        def estimate(self, shown):
            return type(found := super().estimate(shown))(*(each[1:] for each in found))

    class Lost(NoMotion):
        def estimate(self, shown):
            found = super().estimate(shown)
            return found._replace(to_first=found.to_first * np.nan)

    with pytest.raises(RacinesError, match=r"no-motion: transforms of shapes .*\(8, 4, 4\) twice"):
        estimate_all([Short()], sweeps, [sweep])
    with pytest.raises(RacinesError, match="not finite"):
        estimate_all([Lost()], sweeps, [sweep])


def test_the_command_says_what_is_lacking(tmp_path: Path):
    def told(*words: str) -> str:
        with pytest.raises(RacinesError) as caught:
            CliRunner().invoke(app, list(words), catch_exceptions=False)
        return str(caught.value)

    nowhere = "--data", str(tmp_path / "none")
    assert "none: no dataset here" in told("eval", "motion", "no-motion", *nowhere)
    assert "no-motion is not trained" in told("train", "motion", "no-motion", *nowhere)
    assert "no such file" in told("eval", "motion", "absent.npz", *nowhere)
    assert "it has no run" in told("eval", "motion", "a.npz", "--run", "b", *nowhere)
    words = ["export", "motion", "no-motion", "--out", "a.csv", *nowhere]
    assert CliRunner().invoke(app, words).exit_code == 2
    assert not list(tmp_path.iterdir())
