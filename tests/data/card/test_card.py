"""What a card says, and that what it says is so."""

import re
from pathlib import Path

import numpy as np
import pytest
import yaml

from racines_data.build.dataset import DataConfig, build
from racines_data.card.frames import statistics_table
from racines_data.card.markdown import write_card
from racines_data.manifest import read_manifest
from racines_data.schema import PARAMETERS, frame_features
from racines_data.store.frames import open_store
from racines_data.views import PAPER_STATISTICS
from tests.conftest import command
from tests.data.scan_source import ScanConfig, ScanSource
from tests.documents import blocks


@pytest.fixture(scope="module")
def scanned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("card") / "racines"
    build(ScanSource(ScanConfig()), root, DataConfig(workers=1))
    return root


def text(root: Path) -> str:
    return (root / "README.md").read_text()


def cells(line: str) -> list[str]:
    return [cell.strip() for cell in line.strip("|").split("|")]


def row(card: str, name: str) -> list[str]:
    return cells(next(line for line in card.splitlines() if line.startswith(f"| {name}")))


def test_front_matter(scanned: Path):
    head = yaml.safe_load(text(scanned).split("---\n")[1])
    assert head["license"] == "cc-by-4.0" and head["size_categories"] == ["n<1K"]
    assert {"ultrasound", "phantom", "synthetic"} <= set(head["tags"])
    assert head["task_categories"] == ["image-classification", "reinforcement-learning", "robotics"]
    assert [c["config_name"] for c in head["configs"]] == list(read_manifest(scanned)["configs"])


def test_the_first_line_names_the_source_and_every_section_is_there(scanned: Path):
    body = text(scanned).split("---\n", 2)[2]
    assert "`phantom`" in body.splitlines()[0] and "simulated" in body.splitlines()[0]
    assert "research software, not a medical device" in body
    sections = re.findall(r"^## (.*)$", body, re.MULTILINE)
    wanted = ["What a row is", "Configs and splits", "Load", "Version and digests"]
    wanted += ["How it was made", "Statistics", "Classes and grades", "Intended use and limits"]
    assert sections == [*wanted, "Datasheet"]
    parts = ["Motivation", "Composition", "Collection", "Preprocessing, labelling", "Uses"]
    assert re.findall(r"^### (.*)$", body, re.MULTILINE) == [
        *parts,
        "Distribution",
        "Maintenance",
    ]
    assert "None" not in re.sub(r"None:", "", body)


def test_every_column_stands_in_the_table(scanned: Path):
    section = text(scanned).partition("## What a row is")[2].partition("\n## ")[0]
    assert set(re.findall(r"`(\w+)`", section)) >= set(frame_features())


def test_statistics_are_those_of_the_frames_beside_the_papers(scanned: Path):
    values = open_store(scanned).parameters.double().numpy()
    card = text(scanned)
    for index, name in enumerate(PARAMETERS):
        ours, paper = values[:, index], PAPER_STATISTICS[name]
        found = [cell.replace("−", "-") for cell in row(card, f"`{name}` |")]
        pairs = [[float(each) for each in cell.split(" / ")] for cell in found[2:6]]
        mine = ours.min(), ours.max(), ours.mean(), ours.std()
        assert np.allclose([pair[0] for pair in pairs], mine, atol=6e-5)
        theirs = paper.minimum, paper.maximum, paper.mean, paper.std
        assert np.allclose([pair[1] for pair in pairs], theirs, atol=6e-5)
        assert float(found[6]) == pytest.approx((ours.mean() - paper.mean) / paper.std, abs=6e-3)
        assert float(found[7]) == pytest.approx(ours.std() / paper.std, abs=6e-3)


def test_classes_and_grades_are_counted_by_split(scanned: Path):
    store, card = open_store(scanned), text(scanned)
    total, known = 0, int((store.views >= 0).sum())
    for label, name in enumerate(store.labels):
        found = row(card.partition("## Classes")[2], name)
        counts = [int(cell) for cell in found[1:4]]
        for split, count in zip(("train", "validation", "test"), counts, strict=True):
            low, high = store.bounds(split)
            assert count == int((store.views[low:high] == label).sum())
        assert found[4] == f"{100 * sum(counts) / known:.1f} %"
        total += sum(counts)
    assert total == known
    assert "37,736" in card
    assert row(card.partition("## Classes")[2], "A4C")[5] == "19.7 %"  # CACTUS: 7,422 of 37,736
    low, high = store.bounds("train")
    views, grades = store.views[low:high].numpy(), store.grades[low:high].numpy()
    graded = grades[(views != len(store.labels) - 1) & ~np.isnan(grades)]
    shares = [float(cell) for cell in row(card, "train")[-11:]]
    assert sum(shares) == pytest.approx(100, abs=1)
    assert shares[10] == pytest.approx(100 * (graded >= 9.5).mean(), abs=0.06)


def test_pictures_are_referred_to_relatively_and_exist(scanned: Path):
    names = re.findall(r"!\[[^\]]+\]\(([^)]+)\)", text(scanned))
    assert sorted(names) == sorted(f"card/{n}.png" for n in read_manifest(scanned)["pictures"])
    for name in names:
        assert (scanned / name).is_file() and name in read_manifest(scanned)["files"]


def test_python_blocks_of_the_card_run(scanned: Path, tmp_path: Path):
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "racines").symlink_to(scanned)
    (tmp_path / "racines").symlink_to(scanned)
    code = "\n".join(each.text for each in blocks(scanned / "README.md"))
    assert "load_dataset" in code and "open_store" in code
    own = f"import datasets; datasets.config.HF_DATASETS_CACHE = {str(tmp_path / 'cache')!r}"
    command(tmp_path, "python", "-c", f"{own}\n{code}")


def test_an_older_manifest_still_has_a_card(scanned: Path):
    manifest = read_manifest(scanned)
    for key in ("statistics", "pictures", "labels", "poses", "tag"):
        del manifest[key]
    card = write_card(manifest)
    assert "## Statistics" not in card and "](card/" not in card and "## Datasheet" in card


def test_another_organ_is_not_held_against_the_papers_heart(scanned: Path):
    manifest = read_manifest(scanned)
    assert " / " in statistics_table(manifest)
    manifest["labels"] = ["RK", "LIVER", "GB", "Random"]
    assert " / " not in statistics_table(manifest)
