"""Mappings that are proposed, asked for and written; the sheet; and the commands."""

import io
import json
from pathlib import Path

import numpy as np
import polars as pl
import pytest
import yaml
from PIL import Image
from scipy.spatial.transform import Rotation as Turn
from typer.testing import CliRunner

from racines_data.errors import RacinesError
from racines_data.sources.table import TableSource
from racines_data.sources.table.inputs import open_folder
from racines_data.sources.table.inspecting import inspect_mapping
from racines_data.sources.table.mapping import check_mapping
from racines_data.sources.table.propose.ask import ask_mapping
from racines_data.sources.table.propose.guess import guess_mapping
from racines_data.sources.table.propose.write import write_mapping as commented
from racines_leaderboard.cli.command import app
from tests.data.sources.table_folder import (
    COUNT,
    MATRIX,
    QUATERNION,
    ROBOT,
    changed,
    check,
    columns_of,
    sweep,
    synthetic,
    synthetic_folder,
    write_mapping,
)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return synthetic_folder(tmp_path / "mine")


def guessed(folder: Path) -> dict:
    """Return what is proposed, read back from the file that is written."""
    made = guess_mapping(open_folder(folder))
    text = commented(made.parts, made.notes)
    assert yaml.safe_load(text) == json.loads(json.dumps(made.parts))
    assert max(map(len, text.splitlines())) <= 120
    check_mapping(made.parts, "the guess")
    return made.parts


def log(folder: Path, columns: dict, name: str = "log.csv") -> Path:
    """Write a folder of one table and frames in order."""
    folder.mkdir(exist_ok=True)
    for row, image in enumerate(synthetic()[2]):
        Image.fromarray(image).save(folder / f"img_{row}.png", compress_level=1)
    pl.DataFrame(columns).write_csv(folder / name)
    return folder


def _ways() -> dict[str, tuple[dict, dict]]:
    """Return columns as people log them, and what of the guess tells that they were understood."""
    poses, times, _ = synthetic()
    known = columns_of(poses, times)
    turns, at = Turn.from_matrix(poses[:, :3, :3]), poses[:, :3, 3].T
    quaternion = [known[name] for name in QUATERNION]

    def named(names: str, values) -> dict:
        return dict(zip(names.split(), values, strict=True))

    stamp = {"timestamp_ms": times * 1e3}
    return {
        "ros": (
            {
                **named("stamp position.x position.y position.z", [times, *at / 1e3]),
                **named(
                    "orientation.x orientation.y orientation.z orientation.w",
                    [*quaternion[1:], quaternion[0]],
                ),
            },
            {"position": "m", "rotation": "quaternion", "order": "xyzw"},
        ),
        "matrix": (
            {**stamp, **dict(zip(MATRIX, poses.reshape(-1, 16).T, strict=True))},
            {"rotation": "matrix", "time": "ms"},
        ),
        "matrix without names": (
            {
                **stamp,
                **dict(zip([f"c{i}" for i in range(16)], poses.reshape(-1, 16).T, strict=True)),
            },
            {"rotation": "matrix"},
        ),
        "roll pitch yaw": (
            {
                **named("time_ns", [(times * 1e9).astype(np.int64)]),
                **named("x_mm y_mm z_mm", at),
                **named("roll pitch yaw", turns.as_euler("xyz", degrees=True).T),
            },
            {"rotation": "euler", "unit": "deg", "position": "mm", "time": "ns"},
        ),
        "arm": (
            {
                **named("t", [times]),
                **named("tcp_x tcp_y tcp_z", at / 1e3),
                **named("rotvec_x rotvec_y rotvec_z", turns.as_rotvec().T),
                **named("fx fy fz tx ty tz", np.full((6, COUNT), -1.0)),
            },
            {"rotation": "vector", "unit": "rad", "position": "m"},
        ),
    }


@pytest.mark.parametrize("way", _ways())
def test_columns_as_people_log_them(tmp_path: Path, folder: Path, way: str):
    columns, told = _ways()[way]
    made = guessed(log(tmp_path / "log", columns))
    poses = made["poses"]
    assert made["frame"] == "robot" and made["images"]["path"] == "*.png"
    assert poses["rotation"]["kind"] == told["rotation"]
    for key in ("order", "unit"):
        assert told.get(key) in (None, poses["rotation"].get(key))
    assert told.get("position") in (None, poses.get("position", {}).get("unit"))
    assert told.get("time") in (None, poses["time"]["unit"])
    assert ("forces" in made) == (way == "arm")
    made["segments"] = 1
    check(sweep(tmp_path / "log", made), sweep(folder, ROBOT))


def test_a_table_a_sweep_a_video_a_sweep_and_columns_of_labels(tmp_path: Path):
    poses, times, images = synthetic()
    for name in ("one", "two", "three"):
        table = pl.DataFrame({**columns_of(poses, times), "view": ["KLX", ""] * 12})
        table.write_parquet(tmp_path / f"{name}.parquet")
        np.save(tmp_path / f"{name}.npy", images)
    made = guessed(tmp_path)
    assert made["poses"]["file"] == "*.parquet" and made["images"]["path"] == "{sweep}.npy"
    assert made["labels"] == {"view": "view", "views": ["KLX"]} and "segments" not in made
    write_mapping(tmp_path, made)
    units = TableSource.from_config({}, [tmp_path]).plan()
    assert [unit.id for unit in units] == ["one", "three", "two"]


def test_numbered_images_and_none(tmp_path: Path):
    poses, times, images = synthetic()
    columns = {**columns_of(poses, times), "frame": np.arange(COUNT) + 5}
    log(tmp_path / "a", columns)
    for row in range(COUNT):
        (tmp_path / f"a/img_{row}.png").rename(tmp_path / f"a/shot{row + 5:05d}.png")
    assert guessed(tmp_path / "a")["images"]["path"] == "shot{frame:05d}.png"
    (tmp_path / "b").mkdir()
    pl.DataFrame({"a": [1, 2]}).write_csv(tmp_path / "b/none.csv")
    with pytest.raises(RacinesError, match="no table of poses found.*; the best has a"):
        guess_mapping(open_folder(tmp_path / "b"))


def test_answers_take_the_place_of_guesses(folder: Path):
    made = guess_mapping(open_folder(folder)).parts
    asked = []

    def answer(question: str, held: str) -> str:
        asked.append(question.split()[-1])
        return {"poses.position.unit": "cm", "segments": "7"}.get(asked[-1], held)

    made = ask_mapping(made, answer)
    assert made["poses"]["position"]["unit"] == "cm" and made["segments"] == 7
    assert "poses.rotation.order" in asked and "poses.rotation.unit" not in asked
    with pytest.raises(RacinesError, match="frame"):
        ask_mapping(made, lambda question, held: "moon" if "\n  frame" in question else held)


def test_what_looks_wrong_is_said_and_drawn_all_the_same(folder: Path):
    wrong = changed(
        ROBOT,
        poses__position__unit="m",
        poses__rotation__order="xyzw",
        poses__time__unit="ms",
        images__crop=[0, 0, 900, 10],
    )
    made = inspect_mapping(folder, check_mapping(wrong, "m"))
    names = [doubt.name for doubt in made.doubts]
    assert names == ["seconds", "millimetres", "w first"], names
    assert "images.crop" in made.words()[3] and not made.images
    write_mapping(folder, wrong)
    run = CliRunner()
    out = folder.parent / "sheet.png"
    done = run.invoke(app, ["data", "inspect", str(folder), "--out", str(out)])
    assert done.exit_code == 0 and "millimetres" in done.stdout, done.stdout
    assert Image.open(io.BytesIO(out.read_bytes())).size[0] > 1000
    assert run.invoke(app, ["data", "inspect", str(folder), "--out", "a.jpg"]).exit_code == 2


def test_the_gate_is_asked_too(folder: Path):
    turned = np.diag([1.0, -1.0, -1.0, 1.0]).tolist()
    up = changed(ROBOT, calibration__image_to_probe=turned)
    words = inspect_mapping(folder, check_mapping(up, "m")).words()
    assert len(words) == 1 and "looks up" in words[0]
    assert inspect_mapping(folder, check_mapping(up, "m"), ["looks-up"]).words() == []


def test_the_commands_from_a_folder_to_a_mapping(folder: Path, monkeypatch: pytest.MonkeyPatch):
    run = CliRunner()
    done = run.invoke(app, ["data", "map", str(folder), "--guess", "--json"])
    assert done.exit_code == 0 and json.loads(done.stdout)["mapping"]["frame"] == "robot"
    text = (folder / "mapping.yaml").read_text()
    assert "order: wxyz  # which of the four columns is w" in text
    done = run.invoke(app, ["data", "map", str(folder), "--guess"])
    assert isinstance(done.exception, RacinesError) and "--force" in str(done.exception)
    done = run.invoke(app, ["data", "map", str(folder), "--force"], input="\n" * 20)
    assert done.exit_code == 0, done.output
    assert yaml.safe_load((folder / "mapping.yaml").read_text()) == yaml.safe_load(text)


def test_decimal_commas_are_proposed_as_such(folder: Path):
    table = pl.read_csv(folder / "poses.csv")
    (folder / "poses.csv").write_text(table.write_csv(separator=";", decimal_comma=True))
    made = guessed(folder)
    assert made["poses"]["decimal_comma"] is True
    assert made["poses"]["rotation"]["kind"] == "quaternion"
    write_mapping(folder, made)
    assert sum(unit.frames for unit in TableSource.from_config({}, [folder]).plan()) == COUNT


def test_a_quaternion_that_is_numbered_has_its_scalar_at_0(tmp_path: Path):
    poses, times, _ = synthetic()
    known = columns_of(poses, times)
    columns = {name: known[name] for name in ("t", "x", "y", "z")}
    # As some drivers log it: the vector first, the scalar, number 0, last.
    columns |= {f"q{i}": known[QUATERNION[i]] for i in (1, 2, 3, 0)}
    rotation = guessed(log(tmp_path / "log", columns))["poses"]["rotation"]
    assert (rotation["columns"], rotation["order"]) == (["q0", "q1", "q2", "q3"], "wxyz")
