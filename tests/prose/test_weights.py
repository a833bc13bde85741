"""The budget of tracked weights: within its limits, and nothing without a line in its table."""

import subprocess
from pathlib import Path

import pytest
import torch
from safetensors.torch import save_file

from racines_models.weights import SMALL
from tests.prose import weights
from tests.prose.markers import ROOT


def test_all_weights_fit_and_each_does():
    sizes = {each.path: each.size for each in weights.tracked()}
    assert sizes, "git tracks some"
    large = {path: size for path, size in sizes.items() if size > weights.LARGEST}
    assert not large, f"larger than {weights.LARGEST / 1e6:.0f} MB: {large}"
    total = sum(sizes.values())
    told = f"{total / 1e6:.1f} MB of {weights.MOST / 1e6:.0f}: docs/weights.md says what makes room"
    assert total <= weights.MOST, told


def test_every_file_falls_under_one_line_and_every_line_has_a_file():
    groups = [weights.group_of(each.path) for each in weights.tracked()]
    strange = [each.path for each in weights.tracked() if weights.group_of(each.path) is None]
    assert not strange, f"say in tests/prose/weights.py what they are for: {strange}"
    assert set(groups) == set(weights.GROUPS), "a line without files"
    counts = [int(row[1]) for row in weights.table()["rows"]]
    assert counts.pop() == sum(counts) == len(weights.tracked())


def test_boards_name_their_judges_and_rows_their_weights():
    boards = {each.path: weights.named()[each.sha256] for each in weights.tracked()}
    assert boards["models/weights/grader/grader.safetensors"] >= {"phantom-reference"}
    assert boards["envs/weights/servo/seed-2/policy.safetensors"] == {"patients", "beating"}
    assert boards["envs/weights/ppo.onnx"] == set()


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """A repository with two tracked files of weights, and one that is not tracked."""
    folder = tmp_path / "envs/weights/new"
    folder.mkdir(parents=True)
    large, small = torch.zeros(SMALL + 1), torch.zeros(SMALL)
    save_file({"a": large, "b": small, "c": large.half()}, folder / "policy.safetensors")
    (tmp_path / "model.onnx").write_bytes(b"x" * 10)
    subprocess.run(["git", "init", "-q"], cwd=tmp_path, check=True)
    subprocess.run(["git", "add", "."], cwd=tmp_path, check=True)
    (tmp_path / "untracked.onnx").write_bytes(b"x")
    return tmp_path


def test_tracked_weights_are_measured(checkout: Path):
    first, second = weights.tracked(checkout)
    assert first.path == "envs/weights/new/policy.safetensors" and second.path == "model.onnx"
    assert first.wide == 4 * (SMALL + 1) and second.wide == 0 and second.size == 10
    assert weights.group_of(first.path) == "envs/weights/*"
    assert weights.group_of(second.path) is None
    assert weights.group_of("envs/weights/servo/seed-1/policy.safetensors") == "envs/weights/servo"
    assert weights.group_of("models/weights/more/deep/model.safetensors") is None


def test_the_page_has_the_table():
    assert "tests.prose.weights#TABLE" in (ROOT / "docs/weights.md").read_text()
