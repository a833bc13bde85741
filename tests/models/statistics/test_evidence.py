"""The figures of items beside the scores: written, read again, and what follows from them."""

import numpy as np
import polars as pl
import pytest

from racines_data.errors import RacinesError
from racines_models.statistics import Evidence, figure, set_replicates

RANDOM = np.random.default_rng(0)
UNITS = np.repeat(np.arange(9), [3, 9, 4, 7, 5, 6, 8, 2, 5])
N = len(UNITS)
ITEMS = np.arange(N) * 3


def evidence() -> Evidence:
    kept = Evidence()
    values = RANDOM.gamma(2.0, 1.0, (3, 2, N))
    kept.add("ssim", "mean", values, ITEMS, UNITS)
    kept.add("view_agreement", "rate", values > 0.5, ITEMS, UNITS)
    holes = values.copy()
    holes[:, :, UNITS == 4] = np.nan
    kept.add("pose_error_mm", "median", holes, ITEMS, UNITS)
    sets = [lambda keep, row=row: float(row[:, keep].mean()) for row in values]
    kept.add_set("fid", set_replicates(sets, UNITS))
    return kept


def test_what_is_read_is_what_was_written(tmp_path):
    kept = evidence()
    told = kept.write(tmp_path / "a.parquet")
    read = Evidence.read(tmp_path / "a.parquet")
    assert list(read.figures) == ["ssim", "view_agreement", "pose_error_mm", "fid"]
    for name, figures in kept.figures.items():
        assert read.figures[name].interval() == figures.interval()
        first, again = figures.replicates(), read.figures[name].replicates()
        assert (first.whole == again.whole).all() and (first.without == again.without).all()
        assert (first.units, first.n) == (again.units, again.n)
    assert told == read.write(tmp_path / "b.parquet") | {"file": "a.parquet"}


def test_figures_of_draws_are_one_items_and_those_of_trainings_are_not():
    kept = evidence()
    found = kept.figures["ssim"].interval()
    assert (found.n, found.units, found.trainings) == (N, 9, 3)
    values = kept.figures["ssim"].values
    assert values is not None and found.value == pytest.approx(values.mean())
    median = kept.figures["pose_error_mm"].interval()
    assert (median.n, median.units) == (int((UNITS != 4).sum()), 8)


def test_a_figure_of_few_values_stands_as_in_a_scores_file():
    values = np.array([1.0, 4.0, np.nan, 2.0])
    kept = Evidence().add("steps", "mean", values, np.arange(4), np.arange(4))
    found = figure("mean", values, "steps", 0.0)
    assert found == kept.interval(0.0).to_json("steps") and found["n"] == 3 and found["low"] == 0
    assert figure("rate", [True, False])["value"] == 0.5
    assert figure("mean", values, units=[1, 1, 1, 2])["settings"]["units"] == 2
    none = {"value": None, "low": None, "high": None, "n": 0}
    assert figure("mean", []) == none == figure("rate", [np.nan])
    assert figure("median", [], "steps") == none | {"unit": "steps"}


def test_an_interval_is_cut_at_the_ends_that_the_file_keeps(tmp_path):
    kept, values = Evidence(), np.where(UNITS == 2, 0.4, 0.99)
    kept.add("share", "mean", values, ITEMS, UNITS, 0.0, 1.0)
    kept.add("error", "median", np.where(UNITS > 4, 0.0, values), ITEMS, UNITS, 0.1)
    kept.add_set("fid", set_replicates([lambda keep: values[keep].mean()], UNITS), 0.8, 0.95)
    kept.add("any", "mean", values, ITEMS, UNITS)
    kept.write(tmp_path / "a.parquet")
    read = Evidence.read(tmp_path / "a.parquet").figures
    assert read["share"].interval().high == 1.0 < read["any"].interval().high
    assert read["error"].interval().low == 0.1
    assert (read["fid"].interval().low, read["fid"].interval().high) == (0.8, 0.95)
    assert read["share"].interval(maximum=0.97).high == 0.97, "the narrower of the two"


def test_a_single_set_and_a_single_training():
    kept = Evidence()
    kept.add("ssim", "mean", np.arange(N) / N, ITEMS, UNITS)
    assert kept.figures["ssim"].interval().trainings == 1


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda table: table.head(table.height - 1), "damaged"),
        (lambda table: table.with_columns(value=pl.col("value").cast(pl.Float32)), "columns"),
        (lambda table: pl.concat([table, table.tail(3)]), "damaged"),
        (lambda table: table.sample(fraction=1.0, shuffle=True, seed=1), "damaged"),
        (lambda table: table.with_columns(statistic=pl.lit("mode")), "statistic"),
        (lambda table: table.drop("unit"), "columns"),
    ],
)
def test_a_damaged_file_is_refused(tmp_path, change, expected):
    path = tmp_path / "a.parquet"
    evidence().write(path)
    change(pl.read_parquet(path)).write_parquet(path)
    with pytest.raises(RacinesError, match=expected) as caught:
        Evidence.read(path)
    assert str(path) in str(caught.value)


def test_a_file_that_is_none_is_refused(tmp_path):
    with pytest.raises(RacinesError, match="no evidence"):
        Evidence.read(tmp_path / "none.parquet")
    (tmp_path / "a.parquet").write_bytes(b"PAR1 not")
    with pytest.raises(RacinesError, match="not readable"):
        Evidence.read(tmp_path / "a.parquet")


def test_shapes_that_do_not_fit_are_refused():
    kept = Evidence()
    with pytest.raises(ValueError, match="values"):
        kept.add("ssim", "mean", np.zeros(N - 1), ITEMS, UNITS)
    with pytest.raises(ValueError, match="statistic"):
        kept.add("ssim", "set", np.zeros(N), ITEMS, UNITS)
    kept.add("ssim", "mean", np.zeros(N), ITEMS, UNITS)
    with pytest.raises(ValueError, match="already"):
        kept.add("ssim", "mean", np.zeros(N), ITEMS, UNITS)


def test_units_that_do_not_fit_the_file_are_refused():
    with pytest.raises(ValueError, match="units are numbers of 32 bits"):
        Evidence().add("x", "mean", np.ones(2), [0, 1], [1, 1 + 2**32])
