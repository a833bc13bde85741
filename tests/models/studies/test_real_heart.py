"""Surfaces of a heart: their volumes are known in closed form; what a population's table asks."""

import json
import os
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from racines_data.errors import RacinesError
from racines_leaderboard.cli.command import app
from racines_models.studies.real_heart.measures import (
    UNITS,
    heart_measures,
    measure_phases,
    read_heart,
)
from racines_models.studies.real_heart.meshes import (
    Mesh,
    open_edges,
    openings,
    oriented,
    read_obj,
    volume,
    welded,
)
from racines_models.studies.real_heart.report import compare, draw, read_population, spread

SHARED = Path(os.environ.get("RACINES_REAL", Path(__file__).parents[4] / "shared" / "real"))


def cup(radius: float, depth: float, x: float = 0.0, around: int = 64, along: int = 32) -> Mesh:
    """Half an ellipsoid, open at z = 0, its apex at -depth, mm."""
    turn = np.arange(around) * 2 * np.pi / around
    down = np.linspace(0, np.pi / 2, along + 1)[:-1]
    ring = np.stack([np.cos(turn), np.sin(turn)], 1)
    points = [np.c_[radius * np.cos(d) * ring, np.full(around, -depth * np.sin(d))] for d in down]
    vertices = np.concatenate([*points, [[0.0, 0.0, -depth]]]) + [x, 0.0, 0.0]
    faces = []
    for row in range(along - 1):
        for i in range(around):
            a, b = row * around + i, row * around + (i + 1) % around
            faces += [(a, b, a + around), (b, b + around, a + around)]
    last = (along - 1) * around
    faces += [(last + i, last + (i + 1) % around, along * around) for i in range(around)]
    return Mesh(vertices, np.array(faces))


def write(path: Path, mesh: Mesh) -> None:
    lines = [f"v {x:.5f} {y:.5f} {z:.5f}" for x, y, z in mesh.vertices]
    lines += [f"f {a} {b} {c}" for a, b, c in (mesh.faces + 1).tolist()]
    path.write_text("# OBJ\n" + "\n".join(lines) + "\n", encoding="utf-8")


def heart(folder: Path, beats: tuple[float, ...] = (1.0, 0.9, 0.8)) -> Path:
    """An LV, an RV beside it, and a shell 10 mm about the LV, whose beat is a shrinking."""
    for phase, size in enumerate(beats):
        shapes = {
            "LV_ENDOCARDIAL": cup(25 * size, 90 * size),
            "RV_ENDOCARDIAL": cup(20, 60, 45 * size),
        }
        shapes["EPICARDIAL"] = cup(25 * size + 10, 90 * size + 10)
        for name, mesh in shapes.items():
            write(folder / f"somebody_{name}_{phase:03d}.obj", mesh)
    return folder


def test_a_cup_is_closed_at_its_opening_and_holds_half_an_ellipsoid():
    mesh = cup(25, 90)
    exact = 2 / 3 * np.pi * 25 * 25 * 90 / 1e3
    assert volume(mesh) == pytest.approx(exact, rel=5e-3)
    assert len(openings(mesh)) == 1 and len(openings(mesh)[0]) == len(open_edges(mesh)) == 64
    moved = Mesh(mesh.vertices + 500.0, mesh.faces[:, ::-1])
    assert volume(moved) == pytest.approx(volume(mesh))


def test_sheets_that_face_each_other_and_meet_by_position_hold_what_the_whole_does():
    mesh = cup(25, 90)
    right = mesh.vertices[mesh.faces].mean(1)[:, 0] > 0
    faces = np.concatenate([mesh.faces[right], mesh.faces[~right][:, ::-1] + len(mesh.vertices)])
    sheets = Mesh(np.concatenate([mesh.vertices, mesh.vertices]), faces)
    assert len(openings(oriented(welded(sheets)))) == 1
    assert volume(sheets) == pytest.approx(volume(mesh))


def test_a_beat_is_measured(tmp_path):
    phases = measure_phases(read_heart(heart(tmp_path)))
    found = heart_measures(phases)
    assert set(found) == set(UNITS)
    assert found["lv_ef"] == pytest.approx(100 * (1 - 0.8**3), abs=0.1)
    assert found["lv_length_ed"] == pytest.approx(90, abs=0.1)
    assert found["lv_shortening"] == pytest.approx(18, abs=0.1)
    assert found["lv_diameter_ed"] == pytest.approx(2 * 25 * np.sqrt(0.75), abs=0.5)
    assert found["wall_ed"] == pytest.approx(10, abs=0.7) and abs(found["rv_ef"]) < 1e-9
    assert 2 < found["septum_ed"] < 8
    content = compare(phases)
    assert len(content["phases"]) == 3 and content["population"] == {}
    assert draw(content)[:4] == b"\x89PNG"


def test_a_population_stands_beside_it(tmp_path, monkeypatch):
    people = [{"patient": i, "pathology": "healthy", "lv_ef": 50.0 + i} for i in range(10)]
    people += [{"patient": 10, "pathology": "dilated", "lv_ef": 20.0, "lv_edv": 250.0}]
    found = spread(people)
    assert found["healthy"]["lv_ef"]["n"] == 10 and found["all"]["lv_ef"]["low"] == 20.0
    assert found["dilated"]["lv_edv"]["sd"] is None and "lv_edv" not in found["healthy"]
    file = tmp_path / "population.json"
    file.write_text(json.dumps({"patients": people}))
    (tmp_path / "surfaces").mkdir()
    heart(tmp_path / "surfaces")
    monkeypatch.chdir(tmp_path)
    words = ["study", "real-heart", "--real", "surfaces", "--population", file.name, "--out", "it"]
    told = json.loads(CliRunner().invoke(app, [*words, "--json"]).stdout)
    assert told["schema"] == "racines.real-heart/1"
    row = told["measures"]["lv_ef"]
    assert (
        row["inside"] and abs(row["deviations"]) < 3 and "inside" not in told["measures"]["rv_ef"]
    )
    assert (tmp_path / "it.png").is_file() and json.loads(
        (tmp_path / "it.json").read_text()
    ) == told
    shown = CliRunner(env={"COLUMNS": "200"}).invoke(app, words).stdout
    assert "lv_shortening" in shown and "inside" in shown and "healthy" in shown


def test_bad_files_are_named_with_the_remedy(tmp_path):
    path = tmp_path / "a.obj"
    path.write_text("v 0 0 0\nf 1 2 3\n")
    with pytest.raises(RacinesError, match=r"a.obj: line 2: face names vertex 2 of 1; export it"):
        read_obj(path)
    path.write_text("v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1/1 2/2 3/3\n")
    with pytest.raises(RacinesError, match="no finite vertices"):
        read_obj(path)
    with pytest.raises(RacinesError, match="surfaces of 0 hearts"):
        read_heart(tmp_path)
    heart(tmp_path)
    (tmp_path / "somebody_EPICARDIAL_001.obj").unlink()
    with pytest.raises(RacinesError, match="phase 001 lacks EPICARDIAL"):
        read_heart(tmp_path)
    file = tmp_path / "p.json"
    for content, told in (
        ("{", "not valid JSON"),
        ('[{"patient": 1}]', "no patient has one of lv_edv"),
        ('[{"patient": 7, "lv_ef": "60"}]', "patient 7: lv_ef is '60'; give a number"),
        ("3", "no list of patients"),
    ):
        file.write_text(content)
        with pytest.raises(RacinesError, match=told):
            read_population(file)


def test_a_real_heart_measures_as_hearts_do():
    folder = SHARED / "bivme"
    if not folder.is_dir():
        pytest.skip(f"NO REAL HEART: {folder} is absent; surfaces of known volume are measured")
    surfaces = read_heart(folder)
    assert len(surfaces) == 25
    found = heart_measures(measure_phases(surfaces[:11:5]))
    assert 50 < found["lv_ef"] < 65 and 100 < found["lv_edv"] < 200
    assert 10 < found["lv_shortening"] < 22 and 6 < found["septum_ed"] < 12
    assert 0.7 < found["rv_edv"] / found["lv_edv"] < 1.3
