"""What `racines doctor` finds: whole or broken, and how it is told."""

import json
import shutil
from pathlib import Path

import pytest
from typer.testing import CliRunner

from racines_leaderboard.cli.command import app
from racines_leaderboard.doctor import examine, installed, machine
from racines_models.published import places
from tests.conftest import command


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with one small set of weights and its manifest, and nothing else."""
    monkeypatch.chdir(tmp_path)
    folder = places.WEIGHTS / "grader"
    folder.mkdir(parents=True)
    shutil.copy(places.CHECKOUT / places.POLICIES / "ppo/policy.safetensors", folder)
    from racines_data.files import sha256_file

    file = folder / "policy.safetensors"
    told = {"bytes": file.stat().st_size, "sha256": sha256_file(file)}
    one = {"folder": str(folder), "what": "a policy", "files": {file.name: told}, "boards": [],
           "records": []}  # fmt: skip
    manifest = {"schema": "racines.weights/1", "sets": {"grader": one}}
    (places.WEIGHTS / "manifest.json").write_text(json.dumps(manifest))
    return tmp_path


def run(*words: str) -> tuple[int, dict]:
    done = CliRunner().invoke(app, ["doctor", "--json", *words])
    return done.exit_code, json.loads(done.stdout)


def test_nothing_is_broken_and_the_page_fits_a_terminal(here: Path):
    code, report = run("--full")
    assert code == 0 and report["problems"] == [] and report["next"][0].startswith("racines data")
    assert all(each["fits"] for each in report["packages"]) and report["python"]["fits"]
    assert report["machine"]["cores"] >= 1 and report["weights"]["full"]
    page = CliRunner().invoke(app, ["doctor"])
    assert page.exit_code == 0 and "Nothing is broken." in page.stdout
    assert "\x1b" not in page.stdout and max(map(len, page.stdout.splitlines())) < 80


def test_a_file_cut_short_is_found_by_its_size_and_another_by_its_hash(here: Path):
    file = places.WEIGHTS / "grader/policy.safetensors"
    content = bytearray(file.read_bytes())
    content[-1] ^= 1
    file.write_bytes(content)
    assert run()[0] == 0, "sizes alone"
    code, report = run("--full")
    (problem,) = report["problems"]
    assert code == 1 and problem["what"] == str(file) and "sha256" in problem["problem"]
    assert "restore" in problem["remedy"]
    file.write_bytes(content[:-1])
    code, report = run()
    assert code == 1 and "bytes" in report["problems"][0]["problem"]
    assert CliRunner().invoke(app, ["doctor"]).stdout.count(str(file)) >= 1


def test_a_dataset_with_a_missing_or_damaged_file_is_broken(here: Path, tiny_root: Path):
    shutil.copytree(tiny_root, "data/tiny")
    code, report = run()
    assert code == 0 and report["datasets"][0]["what"].startswith("phantom")
    assert report["next"][0] == "racines data validate data/tiny"
    shard = next(Path("data/tiny").rglob("*.parquet"))
    shard.write_bytes(shard.read_bytes()[:-1])
    Path("data/tiny/README.md").unlink()
    code, report = run()
    told = {each["what"]: each for each in report["problems"]}
    assert code == 1 and told["data/tiny/README.md"]["problem"] == "missing"
    assert "damaged" in told[str(shard)]["problem"]
    assert all("racines data build" in each["remedy"] for each in told.values())
    Path("data/tiny/manifest.json").write_text("{", encoding="utf-8")
    (problem,) = run()[1]["problems"]
    assert problem["what"] == "data/tiny/manifest.json" and "rebuild" in problem["remedy"]


def test_a_package_that_is_absent_or_outside_is_told_with_what_to_install(
    here: Path, monkeypatch: pytest.MonkeyPatch
):
    asked = ["numpy>=900", "no-such-package>=2", 'onnx<0; extra == "onnx"', "x; os_name == 'none'"]
    monkeypatch.setattr(installed, "requires", lambda name: asked)
    report = examine.examine()
    told = {each["what"]: each for each in report["problems"]}
    assert set(told) == {"numpy", "no-such-package"}
    assert told["no-such-package"]["problem"] == "missing"
    assert told["numpy"]["remedy"] == 'pip install "numpy>=900"'
    extra = next(each for each in report["extras"] if each["name"] == "onnx")
    assert not extra["usable"] and "[onnx]" in extra["install"]
    assert "onnx lacks onnx: pip install" in examine.page(report)


def test_no_weights_are_no_fault_of_a_wheel(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(places, "CHECKOUT", tmp_path)
    report = examine.examine()
    assert report["problems"] == [] and "none here" in examine.page(report)


def test_the_machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    assert machine.instructions(frozenset(["avx2", "avx512f"])) == "AVX512"
    assert machine.instructions(frozenset(["avx2"])) == "AVX2"
    assert machine.instructions(frozenset()) == "default"
    monkeypatch.setenv(machine.CAPABILITY, "avx2")
    assert "held to avx2" in machine.instructions(frozenset(["avx512f"]))
    card = tmp_path / "0"
    card.mkdir()
    (card / "information").write_text("Model: \t NVIDIA X1\nIRQ: 2\n")
    monkeypatch.setattr(machine, "_built_for", lambda: "13.0")
    assert machine.cuda(tmp_path)["told"] == "13.0: NVIDIA X1" and machine.cuda(tmp_path)["usable"]
    assert "no NVIDIA driver" in machine.cuda(tmp_path / "none")["told"]
    monkeypatch.setattr(machine, "CONFINE", "raise SystemExit('KindError: no filter here')")
    assert machine.confinement() == {"available": False, "why": "no filter here"}


def test_it_loads_no_library_that_takes_seconds(tmp_path: Path):
    code = (
        "import sys\n"
        "from racines_leaderboard.doctor.examine import examine\n"
        "examine()\n"
        "heavy = {'torch', 'datasets', 'polars', 'matplotlib', 'monai', 'torchrl', 'scipy'}\n"
        "assert not heavy & set(sys.modules), heavy & set(sys.modules)\n"
    )
    command(tmp_path, "python", "-c", code, fresh=True)
