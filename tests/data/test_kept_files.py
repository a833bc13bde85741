"""Files that are made once and kept: by whoever comes first, and read only where they are whole."""

import threading
import time
from pathlib import Path

import pytest
import torch
from safetensors.torch import save_file

from racines_data.errors import RacinesError
from racines_data.files import read_tensors, write_once


def test_one_of_two_writers_writes_and_the_other_waits_for_the_whole_file(tmp_path):
    path, wrote, seen = tmp_path / "frames.bin", [], []

    def write(aside: Path) -> None:
        wrote.append(aside)
        with aside.open("wb") as file:
            for _ in range(8):
                file.write(b"frame")
                file.flush()
                time.sleep(0.02)

    def want() -> None:
        write_once(path, write)
        seen.append(path.read_bytes())

    both = [threading.Thread(target=want) for _ in range(2)]
    for each in both:
        each.start()
    for each in both:
        each.join()
    assert len(wrote) == 1
    assert seen == [8 * b"frame"] * 2
    assert [each.name for each in tmp_path.iterdir()] == [path.name]


def test_what_a_killed_writer_left_is_written_again(tmp_path):
    path = tmp_path / "frames.bin"
    path.with_name("frames.bin.part").write_bytes(b"half")
    path.with_name(".frames.bin.lock").touch()
    write_once(path, lambda aside: aside.write_bytes(b"whole") and None)
    assert path.read_bytes() == b"whole"
    assert [each.name for each in tmp_path.iterdir()] == [path.name]


@pytest.fixture
def kept(tmp_path) -> Path:
    path = tmp_path / "kept.safetensors"
    save_file({"one": torch.ones(2), "two": torch.zeros(3)}, path)
    return path


def test_tensors_are_those_named_or_all(kept):
    assert list(read_tensors(kept, ["two"])) == ["two"]
    assert set(read_tensors(kept)) == {"one", "two"}


@pytest.mark.parametrize("damage", ["cut", "empty", "no such tensor", "no file"])
def test_a_damaged_file_is_named_with_the_remedy(kept, damage):
    if damage == "no file":
        kept.unlink()
    elif damage != "no such tensor":
        kept.write_bytes(kept.read_bytes()[: 20 if damage == "cut" else 0])
    with pytest.raises(RacinesError, match=r"kept\.safetensors: damaged \(.*\): train it again"):
        read_tensors(kept, ["one", "three"], "train it again")
