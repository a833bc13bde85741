import json

import pytest
from typer.testing import CliRunner

from racines_data.errors import RacinesError
from racines_data.patients import PATIENTS_VERSION, draw_patient
from racines_leaderboard.cli.command import app
from racines_models.studies.population import (
    NORMS,
    RANGES,
    SEXES,
    TITLES,
    UNITS,
    groups_of,
    tables_of,
)
from racines_models.studies.real_heart.measures import UNITS as REAL
from racines_models.studies.real_heart.report import read_population


@pytest.fixture(scope="module")
def told(tmp_path_factory):
    out = tmp_path_factory.mktemp("population") / "population"
    words = ["study", "population", "--patients", "2", "--split", "validation", "--json"]
    done = CliRunner().invoke(app, [*words, "--out", str(out)])
    assert done.exit_code == 0, done.output
    return json.loads(done.stdout), out.with_suffix(".json")


def test_patients_are_measured_in_what_is_drawn(told):
    content, _ = told
    assert content["world"] == {
        "name": "patients",
        "version": PATIENTS_VERSION,
        "split": "validation",
    }
    for row in content["patients"]:
        patient = draw_patient(row["patient"])
        assert row["pathology"] == patient.pathology
        assert row["sex"] == ("women" if patient.body.female else "men")
        assert set(UNITS) <= set(row)
        assert row["lv_ef"] == pytest.approx(100 * (1 - row["lv_esv"] / row["lv_edv"]), abs=0.01)
        assert row["lv_diameter_ed"] == pytest.approx(patient.form.ventricle, abs=4.5)
        # Measured in voxels 1.3 mm apart: near the numbers that drew them, not those.
        assert row["lv_length_ed"] == pytest.approx(patient.form.length, abs=1.5)
        assert row["lv_shortening"] == pytest.approx(patient.motion.shortening, abs=0.5)
        assert row["root"] == pytest.approx(patient.form.root, abs=1.5)
        assert row["lv_diameter_es"] < row["lv_diameter_ed"] and row["la_volume"] > 10.0
        assert 0.0 < row["wall_thickening"] < 120.0


def test_a_real_heart_can_be_held_against_them(told):
    content, path = told
    assert len(read_population(path)) == 2 and path.with_suffix(".png").is_file()
    assert set(UNITS) & set(REAL) >= {"lv_edv", "lv_ef", "lv_length_ed", "septum_ed", "rv_ef"}


def test_groups_are_of_the_healthy_by_sex_and_of_each_pathology():
    def row(sex, pathology, size):
        return {"sex": sex, "pathology": pathology, **dict.fromkeys(UNITS, size)}

    rows = [row("women", "healthy", 1.0), row("women", "healthy", 3.0), row("men", "dilated", 9.0)]
    groups = groups_of(rows)
    assert [*groups] == ["women", "dilated", "dilated, men"]
    assert groups["women"]["n"] == 2 and groups["women"]["lv_edv"]["mean"] == 2.0
    assert groups["women"]["lv_edv"]["sd"] == pytest.approx(2**0.5)
    assert groups["dilated"]["lv_edv"] == {"mean": 9.0, "sd": None, "low": 9.0, "high": 9.0}
    content = {"groups": groups, "norms": NORMS, "ranges": RANGES, "units": UNITS}
    (head, healthy), others, men = tables_of(content)
    assert head == ("measure", "women, n = 2", "women, norm")
    assert healthy[0] == ("LV across, end diastole, mm", "2.0 ± 1.4\n1 to 3", "45.0 ± 3.6")
    assert ("septum, mm", "2.0 ± 1.4\n1 to 3", "6 to 9") in healthy
    assert others[0] == ("measure", "dilated, n = 1") and others[1][0][1] == "9.0\n9 to 9"
    assert men[0] == ("measure", "dilated, men, n = 1") and men[1] == others[1]
    assert set(TITLES) == set(UNITS)
    assert all(set(norm) == set(SEXES) for norm in NORMS.values()) and set(NORMS) <= set(UNITS)


def test_whom_there_is_not_is_refused(tmp_path):
    for words, told in ((["--split", "all"], "unknown split"), (["--split", "test"], "1 to 140")):
        words = ["study", "population", *words, "--patients", "141", "--out", str(tmp_path / "out")]
        done = CliRunner().invoke(app, words)
        assert done.exit_code == 1 and isinstance(done.exception, RacinesError)
        assert told in str(done.exception)
