import json
from pathlib import Path

import pytest

from racines_data.manifest import read_manifest
from racines_data.sources.images import Kind
from tests.conftest import ROOT, command
from tests.data.release_tree import FRAMES, write_release
from tests.data.sources.test_cactus import PER_VIEW, write_cactus

LOGS = "Folder 1/A4C/logs"


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    return write_release(tmp_path / "release")


def run(folder: Path, *words: str, code: int = 0):
    return command(folder, "racines", "data", "import", *words, "--workers", "1", code=code)


@pytest.mark.slow
def test_kinds_are_counted_and_good_frames_kept(tree: Path, tmp_path: Path):
    (tree / LOGS / "PA_3.txt").unlink()
    (tree / LOGS / "PA_4.txt").write_text("Time: 1\n")
    done = run(tmp_path, "release", "--out", "racines")
    assert "38 frames in 5 trajectories" in done.stdout
    assert "     1  missing log\n" in done.stdout and "     1  unreadable log\n" in done.stdout
    assert "refused: Folder 1/A4C/images/img3.png: missing log: there is no" in done.stdout
    assert read_manifest(tmp_path / "racines")["report"]["refused_frames"] == 2
    done = run(tmp_path, "release", "--out", "again", "--json")
    figures = json.loads(done.stdout)
    assert figures["kinds"] == {"missing log": 1, "unreadable log": 1}
    assert figures["counts"]["frames"] == 5 * FRAMES - 2 and len(figures["findings"]) == 2
    command(tmp_path, "racines", "data", "validate", "racines")


@pytest.mark.slow
def test_refusals_exit_with_one_and_still_tell(tree: Path, tmp_path: Path):
    (tree / LOGS / "PA_3.txt").unlink()
    done = run(tmp_path, "release", "--out", "racines", "--strict", code=1)
    assert "nothing was imported" in done.stdout and "missing log" in done.stdout
    assert done.stderr.startswith("racines: refused (--strict): Folder 1/A4C/images/img3.png")
    done = run(tmp_path, "release", "--out", "racines", "--max-refused", "0", "--json", code=1)
    refusal = json.loads(done.stdout)
    assert refusal["out"] is None and refusal["kinds"] == {"missing log": 1}
    assert "more than max_refused 0.0" in done.stderr
    assert not (tmp_path / "racines").exists()
    run(tmp_path, "nothing", code=1)
    run(tmp_path, code=2)
    run(tmp_path, "release", "--set", "unit", code=2)


def test_settings_reach_the_source(tree: Path, tmp_path: Path):
    done = run(tmp_path, "release", "--set", "unit=mm", code=1)
    assert "metres: the whole set is likely in m" in done.stderr
    run(tmp_path, "release", "--set", "label_views=true", "--set", "reach=0.9", "--out", "racines")
    settings = read_manifest(tmp_path / "racines")["recipe"]["settings"]["config"]
    assert settings["label_views"] is True and settings["reach"] == 0.9


def test_other_sources_are_imported_too(tmp_path: Path):
    write_cactus(tmp_path / "cactus")
    done = run(tmp_path, "cactus", "--source", "cactus", "--out", "graded")
    assert f"{6 * PER_VIEW} frames in 6 trajectories" in done.stdout
    assert "every file is sound" in done.stdout
    assert read_manifest(tmp_path / "graded")["source"] == "cactus"


def test_every_kind_is_explained():
    text = (ROOT / "docs" / "import.md").read_text()
    assert all(f"| {kind} |" in text for kind in Kind)
