"""The study of coverage: studies drawn from a population, counted; and the table made of it."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest
import torch

from racines_data.errors import RacinesError
from racines_models.statistics import levels
from racines_models.statistics.intervals import Interval, interval, mean_replicates
from racines_models.studies.coverage import population as measured
from racines_models.studies.coverage import run as study
from racines_models.studies.coverage.population import FIGURES, Method, Population
from racines_models.studies.coverage.simulation import (
    ITEMS,
    RANKED,
    SETS,
    CoverageConfig,
    Simulation,
)
from tests.models.labelled import LabelledStore, Replay
from tests.models.scores.test_scores import Coarse

ANCHORS = {name: (0.0, 1.0) for name in RANKED}
CONFIG = CoverageConfig(units=(6, 12), studies=120, set_studies=3, dimensions=4)
REPORT = Path("models/runs/coverage.json")


@pytest.fixture(scope="module")
def population() -> Population:
    """40 sweeps of 3 to 20 frames that are near-copies, three trainings that differ."""
    rng = np.random.default_rng(0)
    sizes = rng.integers(3, 21, 40)
    unit = np.repeat(np.arange(40), sizes)
    embedded = np.flatnonzero(np.diff(unit, prepend=-1))
    embedded = np.sort(np.concatenate([embedded, embedded + 2]))

    def method(shift: float, trainings: int) -> Method:
        level = rng.gamma(2.0, 1.0, 40)[unit] + rng.normal(0, 0.2, (trainings, len(unit))) + shift
        level += rng.normal(0, 0.1, (trainings, 1))
        features = rng.normal(shift, 1.0, (trainings, len(embedded), 8))
        return Method({name: level for name in FIGURES}, torch.from_numpy(features).float())

    truth = torch.from_numpy(rng.normal(0.0, 1.0, (len(embedded), 8))).float()
    return Population(unit, embedded, truth, method(0.0, 3), method(0.5, 1))


@pytest.fixture(scope="module")
def simulation(population) -> Simulation:
    return Simulation(population.project(CONFIG.dimensions, 0), CONFIG, ANCHORS)


@pytest.fixture(scope="module")
def content(simulation, tmp_path_factory) -> dict:
    rows = study.simulate(simulation, tmp_path_factory.mktemp("rows") / "rows.parquet")
    return study.report(simulation, rows, {"digest": "d"}, {"a": {}, "b": {}}, 0.0)


def test_every_kind_has_its_coverage_at_every_size(content):
    sizes = {(row["kind"], row["units"], row["trainings"]) for row in content["rows"]}
    kinds = (*ITEMS, *SETS)
    assert sizes == {(kind, u, r) for kind in kinds for u in (6, 12) for r in (1, 3)}
    for row in content["rows"]:
        assert row["n"] == (120 if row["kind"] in ITEMS else 3)
        assert 0.0 <= row["low"] <= row["coverage"] <= row["high"] <= 1.0
    assert study.draw_coverage(content)[:4] == b"\x89PNG"
    json.dumps(content, allow_nan=False)


def test_frames_taken_for_units_are_seen_to_under_cover(content):
    """The study can tell: the bad interval is far below, beyond its own error; ours is not."""
    found = {(r["kind"], r["units"], r["trainings"]): r for r in content["rows"]}
    for units in (6, 12):
        bad, ours = (found[kind, units, 1] for kind in ("frames as units", "mean"))
        assert bad["high"] < 0.75
        assert ours["low"] > bad["high"] and ours["coverage"] >= 0.88


def test_what_is_to_be_held_is_the_populations_value(population, simulation):
    ssim = population.first.figures["ssim"]
    assert simulation.targets(1)["mean"] == pytest.approx(ssim[0].mean())
    assert simulation.targets(3)["mean"] == pytest.approx(ssim.mean())
    assert simulation.targets(1)["median"] == pytest.approx(np.median(ssim[0]))
    assert simulation.targets(1)["rate"] == pytest.approx(1 - CONFIG.missed, abs=0.01)
    apart = ssim.mean() - population.second.figures["ssim"].mean()
    assert simulation.targets(3)["difference"] == pytest.approx(apart)


def test_drawn_trainings_spread_as_the_measured_ones(population, simulation):
    ssim = population.first.figures["ssim"]
    drawn = simulation._first["ssim"].draw(
        np.random.default_rng(0).standard_normal((20000, 3)), np.arange(ssim.shape[1])
    )
    assert np.allclose(drawn.var(0), ssim.var(0, ddof=1), rtol=0.1)
    assert np.allclose(drawn.mean(0), ssim.mean(0), atol=0.02)
    alone = simulation._first["ssim"].draw(None, np.arange(5))
    assert np.allclose(alone, ssim[:1, :5])


def test_a_study_draws_whole_trajectories_and_depends_on_its_number_alone(simulation):
    one, again, other = (dict(simulation.items(6, 3, number)) for number in (4, 4, 5))
    assert one == again and one["mean"] != other["mean"]
    assert one["mean"].units == 6 and one["mean"].trainings == 3
    assert dict(simulation.sets(12, 3, 0))["fid"].units == 12


def test_a_killed_run_goes_on_where_it_was(simulation, tmp_path, monkeypatch):
    few = replace(CONFIG, units=(6,), trainings=(1,), studies=70, set_studies=2)
    short = Simulation(simulation.population, few, ANCHORS)
    whole = study.simulate(short, tmp_path / "whole.parquet")
    drawn, items = [], short.items

    def dies(units, trainings, number):
        drawn.append(number)
        if len(drawn) == 60:
            raise KeyboardInterrupt
        yield from items(units, trainings, number)

    monkeypatch.setattr(short, "items", dies)
    with pytest.raises(KeyboardInterrupt):
        study.simulate(short, tmp_path / "rows.parquet")
    done = pl.read_parquet(tmp_path / "rows.parquet")
    assert done["study"].n_unique() == study.CHUNK == 50
    drawn.clear()
    monkeypatch.setattr(short, "items", lambda *size: drawn.append(size[2]) or items(*size))
    counted = []
    rows = study.simulate(short, tmp_path / "rows.parquet", counted.append)
    assert drawn == list(range(50, 70)) and sum(counted) == 72
    assert rows.equals(whole)
    (tmp_path / "rows.parquet").write_bytes(b"no parquet")
    with pytest.raises(RacinesError, match=r"rows.parquet: damaged.*delete it"):
        study.simulate(short, tmp_path / "rows.parquet")


def test_studies_of_other_settings_are_kept_apart(simulation, tmp_path):
    def name(config, anchors=ANCHORS):
        return study.rows_file(tmp_path, simulation.population, config, anchors)

    assert name(CONFIG) == name(replace(CONFIG, studies=9, units=(30,)))
    assert name(CONFIG) != name(replace(CONFIG, seed=1))
    assert name(CONFIG) != name(CONFIG, ANCHORS | {"fid": (1.0, 0.0)})


def test_a_population_is_measured_once(tmp_path):
    class Pose:
        settings = {"id": "still"}

        def predict(self, images):
            from racines_data.geometry import parameters_to_pose

            return parameters_to_pose(torch.zeros(len(images), 12))

    store = LabelledStore(trajectories=6, length=8)
    runs = [Replay(store, 0.1), Replay(store, 0.3)], [Replay(store, 0.5)]
    counted: list[int] = []
    size = 24, 12
    args = (store, *runs, Coarse(), Pose(), size, ["key"], tmp_path, counted.append)
    found = measured.measure(*args)
    assert found.units == 6 and found.unit.shape == (24,) and found.truth.shape[0] == 12
    assert found.first.features.shape[:2] == (2, 12) and found.second.figures["psnr"].shape == (
        1,
        24,
    )
    assert found.first.figures["ssim"][0].mean() > found.first.figures["ssim"][1].mean()
    calls = Coarse.calls
    again = measured.measure(*args)
    assert Coarse.calls == calls and np.array_equal(again.first.features, found.first.features)
    shape = found.project(3, 0).truth.shape
    assert shape == (12, 3) and found.project(0, 0) is found
    with pytest.raises(RacinesError, match="one trajectory"):
        measured.measure(LabelledStore(trajectories=1, length=8), *args[1:])


def test_anchors_that_are_not_there_are_named(tmp_path):
    with pytest.raises(RacinesError, match=r"mean-image.json: no scores to anchor by.*--scores"):
        study.read_anchors(tmp_path)


def test_the_level_printed_is_the_lowest_coverage_of_what_a_kind_stands_for():
    rows = [
        {"kind": kind, "units": 6, "trainings": 1, "coverage": share}
        for kind, share in (("mean", 0.95), ("skewed mean", 0.88), ("fid", 0.94), ("kid", 0.931))
    ]
    table = study.levels(rows)["coverage"]
    assert table["mean"] == [{"units": 6, "trainings": 1, "coverage": 0.88}]
    assert table["set"][0]["coverage"] == 0.931 and table["median"] == []


def test_a_level_is_the_nominal_one_or_what_was_measured(monkeypatch):
    rows = [(6, 1, 0.8567), (30, 1, 0.93), (6, 3, 0.9), (30, 3, 0.99)]
    sizes = [dict(zip(("units", "trainings", "coverage"), row, strict=True)) for row in rows]
    monkeypatch.setattr(levels, "_table", lambda: {"nominal": 0.95, "coverage": {"mean": sizes}})
    told = {(6, 1): 0.86, (3, 1): 0.86, (29, 1): 0.86, (30, 1): 0.95, (500, 1): 0.95}
    told |= {(6, 3): 0.9, (6, 2): 0.9, (6, 9): 0.9, (31, 2): 0.95}
    assert {size: levels.nominal("mean", *size) for size in told} == told
    unit = np.arange(6).repeat(3)
    found = interval(mean_replicates(np.random.default_rng(0).gamma(1, 1, 18), unit))
    assert found.to_json()["settings"]["level"] == 0.86
    assert "level" not in Interval(1.0, None, None, 1, 1, 1, "none").to_json()["settings"]


def test_a_table_does_not_stand_without_its_report(monkeypatch, tmp_path):
    assert levels.TABLE.is_file() == REPORT.is_file()
    monkeypatch.setattr(levels, "TABLE", tmp_path / "coverage.json")
    levels._table.cache_clear()
    try:
        assert levels.nominal("mean", 30, 3) is None
        told = Interval(1.0, 0.5, 1.5, 1, 1, 1, "some").to_json()
        assert "level" not in told["settings"]
    finally:
        levels._table.cache_clear()


measured_once = pytest.mark.skipif(not REPORT.is_file(), reason="the study has not been run")


@measured_once
def test_the_table_is_that_of_the_committed_report():
    report = json.loads(REPORT.read_text(encoding="utf-8"))
    assert json.loads(levels.TABLE.read_text()) == report["levels"]
    assert report["levels"] == study.levels(report["rows"])
    sizes = {(row["units"], row["trainings"]) for row in report["rows"]}
    assert sizes == {(units, r) for units in (6, 12, 30, 140) for r in (1, 3)}
    assert {row["kind"] for row in report["rows"]} == {*ITEMS, *SETS}
    assert min(row["n"] for row in report["rows"] if row["kind"] in ITEMS) >= 2000
    for kind in study.STANDS_FOR:
        assert 0.5 < levels.nominal(kind, 30, 3) <= 0.95


@measured_once
def test_the_committed_report_is_of_the_intervals_as_they_are():
    """Where the method of an interval changes, `racines study coverage` is to be run again."""
    report = json.loads(REPORT.read_text(encoding="utf-8"))
    assert np.allclose(study.probe(), report["probe"], rtol=1e-6)
