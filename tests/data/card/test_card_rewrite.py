"""`racines data card`: realism figures come into a finished dataset, and it stays valid."""

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from racines_data.card import rewrite as card_rewrite
from racines_data.card.rewrite import rewrite_card
from racines_data.errors import RacinesError
from racines_data.load import load
from racines_data.manifest import read_manifest
from racines_data.validate.run import validate
from tests.conftest import command


@pytest.fixture
def root(built: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(built, tmp_path / "racines"))


@pytest.fixture
def report(built: Path, tmp_path: Path) -> Path:
    return write(tmp_path / "realism.json", content(read_manifest(built)["digest"]))


@pytest.fixture
def picture(tmp_path: Path) -> Path:
    path = tmp_path / "strip.png"
    Image.fromarray(np.arange(64, dtype=np.uint8).reshape(8, 8)).save(path)
    return path


def content(digest: str) -> dict[str, Any]:
    def figure(value: float) -> dict[str, Any]:
        pair = {"value": value, "low": value - 0.01, "high": value + 0.01}
        return {"rule": "a rule", "phantom": pair, "real": {**pair, "value": 0.0004}}

    return {
        "schema": "racines.realism/1",
        "compared": True,
        "dataset": {"digest": digest},
        "real": {"frames": 250, "patients": 250},
        "view": "A4C",
        "phantom_frames": 125,
        "n": 125,
        "figures": {"kid": figure(0.1234), "gray": figure(9.8), "new": figure(3.0)},
        "ablation": [
            {"name": "no side lobes", "kid": 0.2001, "change": 0.0767},
            {"name": "no shadow", "kid": 0.1134, "change": -0.01},
        ],
    }


def write(path: Path, content: Any) -> Path:
    path.write_text(json.dumps(content), encoding="utf-8")
    return path


def card(root: Path) -> str:
    return (root / "README.md").read_text()


def leftovers(root: Path) -> list[str]:
    return [path.name for path in root.parent.iterdir() if path.name.startswith(".racines")]


def test_realism_comes_into_the_card_and_the_dataset_stays_valid(
    root: Path, report: Path, picture: Path
):
    before = read_manifest(root)
    manifest = rewrite_card(root, [report], [picture])
    text = card(root)
    assert "## Realism" in text and "0.1234 (0.1134 – 0.1334)" in text
    assert "| no side lobes | 0.2001 | +0.0767 |" in text
    assert "| no shadow | 0.1134 | −0.0100 |" in text
    assert "| a rule |" in text, "a figure that is not known by name says its rule"
    assert "(card/realism-strip.png)" in text
    assert (root / "card/realism-strip.png").read_bytes() == picture.read_bytes()
    assert manifest == read_manifest(root) and manifest["digest"] == before["digest"]
    on_disk = {p.relative_to(root).as_posix() for p in root.rglob("*") if p.is_file()}
    assert on_disk == {*manifest["files"], "manifest.json"}
    files = next(check for check in validate(root).checks if check.name == "files")
    assert files.ok, files.detail
    assert load(root=root, split="test").num_rows == before["counts"]["splits"]["test"]["frames"]
    assert leftovers(root) == []


def test_a_new_picture_replaces_the_old_and_figures_stay(root: Path, report: Path, picture: Path):
    rewrite_card(root, [report], [picture])
    other = picture.rename(picture.with_name("other.png"))
    manifest = rewrite_card(root, pictures=[other])
    assert "card/realism-strip.png" not in manifest["files"]
    assert not (root / "card/realism-strip.png").exists()
    assert "(card/realism-other.png)" in card(root) and "0.1234" in card(root)


def test_without_anything_new_the_bytes_stay(root: Path):
    before = {p: p.read_bytes() for p in root.rglob("*") if p.is_file()}
    rewrite_card(root)
    rewrite_card(root, draw=True)
    assert {p: p.read_bytes() for p in root.rglob("*") if p.is_file()} == before


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"dataset": {"digest": "f" * 64}}, "measures another dataset"),
        ({"compared": False}, "holds no comparison"),
        ({"figures": {}}, "holds no comparison"),
        ({"schema": "else/1"}, "schema is 'else/1'"),
    ],
)
def test_a_report_that_does_not_fit_is_refused(
    root: Path, report: Path, change: dict[str, Any], told: str
):
    write(report, {**json.loads(report.read_text(encoding="utf-8")), **change})
    before = card(root)
    with pytest.raises(RacinesError, match=f"realism.json: {told}"):
        rewrite_card(root, [report])
    assert card(root) == before and leftovers(root) == []


def test_what_is_no_picture_is_refused(root: Path, picture: Path):
    for name, data in {"a.png": b"no", "b.png": picture.read_bytes()[:60]}.items():
        path = picture.with_name(name)
        path.write_bytes(data)
        with pytest.raises(RacinesError, match=f"{name}: no readable picture"):
            rewrite_card(root, pictures=[path])
    large = picture.with_name("large.png")
    noise = np.random.default_rng(0).integers(0, 256, (1600, 1600), np.uint8)
    Image.fromarray(noise).save(large)
    with pytest.raises(RacinesError, match="at most 2 MB"):
        rewrite_card(root, pictures=[large])


def test_a_damaged_dataset_is_not_sealed_anew(root: Path):
    path = root / "import_report.parquet"
    path.write_bytes(path.read_bytes()[:-1] + b"x")
    with pytest.raises(RacinesError, match="import_report.parquet: damaged"):
        rewrite_card(root)


def test_what_fails_half_way_leaves_the_dataset(
    root: Path, report: Path, monkeypatch: pytest.MonkeyPatch
):
    before = {p: p.read_bytes() for p in root.rglob("*") if p.is_file()}

    def stop(*_: Any) -> None:
        raise OSError("no space left")

    monkeypatch.setattr(card_rewrite, "swap_folder", stop)
    with pytest.raises(OSError, match="no space"):
        rewrite_card(root, [report], draw=True)
    assert {p: p.read_bytes() for p in root.rglob("*") if p.is_file()} == before
    assert leftovers(root) == []


def test_command(root: Path, report: Path, picture: Path, tmp_path: Path):
    words = ("racines", "data", "card", str(root), "--realism", str(report), "--json")
    told = json.loads(command(tmp_path, *words, "--picture", str(picture)).stdout)
    assert told["sha256"] == read_manifest(root)["files"]["README.md"]["sha256"]
    assert "card/realism-strip.png" in told["pictures"]
    write(report, {})
    assert "schema is None" in command(tmp_path, *words, code=1).stderr
