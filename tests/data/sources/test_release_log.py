import numpy as np
import pytest

from racines_data.sources.images import Fault as DamagedLog
from racines_data.sources.release.layout import (
    CONTROL,
    FIELDS,
    POSE,
    TIME,
    WRENCH,
    format_log,
    parse_log,
)
from racines_data.sources.release.source import backward
from tests.data.release_tree import log_text, matrix


@pytest.fixture
def row() -> np.ndarray:
    rng = np.random.default_rng(0)
    wrench, control = rng.normal(0, 9, 6), rng.normal(0, 0.01, 6)
    return np.concatenate([[1_700_000_000.123456], wrench, matrix(rng).ravel(), control])


def test_what_numpy_prints_is_read(row: np.ndarray):
    text = log_text(row[TIME], row[WRENCH], row[POSE].reshape(4, 4), row[CONTROL])
    assert np.allclose(parse_log(text), row, atol=1e-7)
    with np.printoptions(linewidth=40, floatmode="fixed", sign=" "):
        text = log_text(row[TIME], row[WRENCH], row[POSE].reshape(4, 4), row[CONTROL])
        assert "\n" in text.rpartition("Control Effort (CO): ")[2].strip()
    assert np.allclose(parse_log(text), row, atol=1e-7)


def test_commas_and_flat_arrays_are_read(row: np.ndarray):
    pose = row[POSE].reshape(4, 4).tolist()
    text = (
        f"Time: {row[TIME]}\r\nForce and Torque: {[[x] for x in row[WRENCH].tolist()]}\r\n"
        f"Pose Matrix (ROT):\r\n{pose}\r\nControl Effort (CO): {row[CONTROL].tolist()}\r\n"
    )
    assert parse_log(text) == row.tolist()
    flat = f"Force and Torque: {row[WRENCH].tolist()}"
    assert parse_log(text.replace(text.split("\r\n")[1], flat)) == row.tolist()


def test_numbers_survive_being_written(row: np.ndarray):
    again = np.array(parse_log(format_log(row)))
    assert again[TIME] == row[TIME]
    assert np.abs(again - row).max() <= 5.1e-9


def test_arrays_stand_as_numpy_prints_them(row: np.ndarray):
    row[3] = -1e-12  # no negative zero
    text, rounded = format_log(row), row.round(8) + 0.0
    with np.printoptions(precision=8, floatmode="fixed", suppress=True, linewidth=200):
        assert f"Force and Torque: {rounded[WRENCH].reshape(6, 1)}\nPose" in text
        assert f"Pose Matrix (ROT):\n{rounded[POSE].reshape(4, 4)}\nControl" in text
        assert f"Control Effort (CO): {rounded[CONTROL]}\n" in text
    assert "e-" not in text and "-0.00000000" not in text


@pytest.mark.parametrize("time", [0.0, 1e-7, 12.0, 1e9 + 1 / 3])
def test_times_are_plain_decimals(row: np.ndarray, time: float):
    row[TIME] = time
    word = format_log(row).splitlines()[0].removeprefix("Time: ")
    assert float(word) == time and set(word) <= set("0123456789.")


def test_absent_numbers_are_nan(row: np.ndarray):
    row[WRENCH] = np.nan
    assert np.isnan(parse_log(format_log(row))[WRENCH]).all()


@pytest.mark.parametrize("name", FIELDS)
def test_a_missing_field_is_named(row: np.ndarray, name: str):
    text = format_log(row).replace(f"{name}:", "Other:")
    with pytest.raises(DamagedLog, match="unreadable log"):
        parse_log(text)


def test_wrong_shapes_and_words_are_named(row: np.ndarray):
    def text(wrench=6, rows=4, columns=4, control=6) -> str:
        return log_text(1.0, np.ones(wrench), np.ones((rows, columns)), np.ones(control))

    for shape in ({"rows": 3}, {"columns": 3}, {"rows": 3, "columns": 3}, {"rows": 1}):
        with pytest.raises(DamagedLog, match=r"wrong matrix shape: Pose.*instead of 4×4"):
            parse_log(text(**shape))
    with pytest.raises(DamagedLog, match="wrong matrix shape: Force.*5×1 numbers instead of six"):
        parse_log(text(wrench=5))
    with pytest.raises(DamagedLog, match="wrong matrix shape: Control.*1×7"):
        parse_log(text(control=7))
    with pytest.raises(DamagedLog, match="unreadable log: Time: could not convert"):
        parse_log(format_log(row).replace("Time: 17", "Time: x17"))
    with pytest.raises(DamagedLog, match="twice"):
        parse_log(format_log(row) * 2)
    with pytest.raises(DamagedLog, match="unreadable log"):
        parse_log("")
    with pytest.raises(DamagedLog, match="unreadable log: Time: '' is not seconds"):
        parse_log(format_log(row).replace(format_log(row).split("\n")[0], "Time:"))


def test_one_wrong_time_costs_one_frame():
    assert backward([1, 2, 3, 4], False) == []
    assert backward([1, 2, 900, 3, 4], False) == [2]
    assert backward([1, 2, 0, 3, 4], False) == [2]
    assert len(backward([1, 2, 2, 3], False)) == 1 and backward([1, 2, 2, 3], True) == []
    assert backward([], False) == []
    rng = np.random.default_rng(0)
    times = rng.permutation(60).astype(float).tolist()
    kept = np.delete(times, backward(times, False))
    assert (np.diff(kept) > 0).all() and len(kept) == longest(times)


def longest(times: list[float]) -> int:
    best: list[int] = []
    for index, time in enumerate(times):
        before = (best[i] for i in range(index) if times[i] < time)
        best.append(1 + max(before, default=0))
    return max(best)
