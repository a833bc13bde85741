"""What the system refuses is one line with the path and the remedy, whichever command meets it."""

import contextlib
import ctypes
import errno
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from pkgutil import resolve_name

import pytest
import typer

from racines_data.errors import describe_os_error
from racines_data.files import naming, write_atomic
from racines_leaderboard.cli import command as cli


class _Head(ctypes.Structure):
    _fields_ = [("version", ctypes.c_uint32), ("pid", ctypes.c_int)]


class _Sets(ctypes.Structure):
    _fields_ = [(name, ctypes.c_uint32) for name in ("effective", "permitted", "inheritable")]


@contextlib.contextmanager
def bound_by_permissions() -> Iterator[None]:
    """Lay down what lets root read and write all: CAP_DAC_OVERRIDE and CAP_DAC_READ_SEARCH."""
    libc, head, sets = ctypes.CDLL(None, use_errno=True), _Head(0x20080522, 0), (_Sets * 2)()
    assert libc.capget(ctypes.byref(head), sets) == 0
    was = sets[0].effective
    sets[0].effective = was & ~0b110
    assert libc.capset(ctypes.byref(head), sets) == 0
    try:
        yield
    finally:
        sets[0].effective = was
        assert libc.capset(ctypes.byref(head), sets) == 0


@pytest.fixture
def ground(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder with one of each thing that refuses, as somebody whom permissions bind."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "dangling").symlink_to("nowhere")
    (tmp_path / "circle").symlink_to("circle")
    (tmp_path / "folder").mkdir()
    (tmp_path / "file").write_text("no\n")
    (tmp_path / "closed").mkdir(mode=0)
    (tmp_path / "shut").write_text("{}")
    (tmp_path / "shut").chmod(0)
    with bound_by_permissions():
        yield tmp_path
    (tmp_path / "closed").chmod(0o700)


REFUSING = {
    "a broken link": "dangling",
    "a circle of links": "circle",
    "a folder": "folder",
    "a file as a folder": "file/inside",
    "a closed folder": "closed/inside",
    "a closed file": "shut",
    "a name too long": "x" * 300,
    "control characters": "a\x1b[31m\nb",
}
NEEDED = {
    "data build": "--source tracked --input {}",
    "data import": "{}",
    "data map": "{} --guess",
    "data inspect": "folder --mapping {}",
    "data validate": "{}",
    "data annotate": "{}",
    "data card": "{}",
    "data export": "{} --format release --out out",
    "phantom from-mesh": "{} --tissues {} --out out",
    "phantom from-labels": "{} --tissues {} --out out",
    "data push": "me/it --root {} --dry-run",
    "train grader": "--data {} --out out",
    "train student": "--data {} --out out",
    "train pose": "--data {} --out out",
    "train segmentation": "--data {} --out out",
    "train motion": "mean-motion --data {} --out out",
    "train encoder": "--data {} --out out",
    "train generator": "mean-image --data {} --out out",
    "train agent": "ppo --params {}",
    "eval generator": "mean-image --data {} --out out.json",
    "eval grader": "--data {}",
    "eval agent": "random --params {}",
    "eval motion": "no-motion --data {} --out out",
    "eval robustness": "planner --params {}",
    "study downstream": "--params {}",
    "study ejection": "planner --segmentation {}",
    "study gallery": "--data {} --out out.png",
    "study realism": "--data {}",
    "study leakage": "--data {}",
    "study conditioning": "mean-image --data {}",
    "study floor": "--data {}",
    "study coverage": "--data {}",
    "study ablation": "--params {}",
    "study rewards": "--params {}",
    "study transfer": "--params {}",
    "study curves": "{}",
    "study forces": "--data {}",
    "study real-heart": "--real {} --out out",
    "study sim-to-real": "--real {} --no-grader --out out",
    "export generator": "mean-image --run {} --out out.onnx",
    "export agent": "--run {} --out out.onnx",
    "export weights": "{} --out out",
    "export poses": "--data {} --out out.parquet",
    "export predictions": "mean-image --data {} --out out.parquet",
    "export motion": "no-motion --data {} --out out.npz",
    "expert sample": "--out out --truth --data {}",
    "expert rate": "{}",
    "expert score": "{} ratings.jsonl",
    "demo": "--patient 1 --out {}",
    "replay": "{}",
    "explain": "--params {}",
    "submit": "{}",
    "leaderboard": "--results {}",
    "board pin": "mine --results {}",
    "study weightings": "mine --results {}",
    "board commit-secret": "tiny --results {}",
    "board reveal": "tiny --secret {}",
    "audit": "mine --results {}",
}
"""What a command needs beside the path, `{}`, that it reads first."""


def run(monkeypatch: pytest.MonkeyPatch, *words: str) -> int:
    """Run a command as a shell does."""
    monkeypatch.setattr(sys, "argv", ["racines", *words])
    try:
        cli.main()
    except SystemExit as stopped:
        return stopped.code if isinstance(stopped.code, int) else int(stopped.code is not None)
    return 0


def check_refused(told: str, code: int, path: str) -> None:
    lines = told.rstrip("\n").split("\n")
    assert code in (1, 2), told
    assert "Traceback" not in told and all(line.isprintable() for line in lines), told
    if code == 1:
        assert len(lines) == 1 and lines[0].startswith("racines: "), told


@pytest.mark.parametrize("refusing", REFUSING)
@pytest.mark.parametrize("words", NEEDED)
def test_a_path_that_refuses_is_told_in_one_line(
    ground: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
    words: str,
    refusing: str,
):
    path = REFUSING[refusing]
    given = [path if word == "{}" else word for word in NEEDED[words].split()]
    code = run(monkeypatch, *words.split(), *given)
    check_refused(capfd.readouterr().err, code, path)


def test_every_command_that_takes_a_path_is_tried():
    taking = set()
    for words, function in cli.COMMANDS.items():
        hints = typer.main.get_params_from_function(resolve_name(function)).values()
        if any("Path" in str(hint.annotation) for hint in hints):
            taking.add(words)
    left = {"data pull", "study sheet", "study speed", "study determinism", "studio", "drive"}
    left |= {"export trace", "export envhub", "study processors", "study population"}
    left |= {"weights card", "weights push"}  # which read no path, and write where they are told
    assert taking - set(NEEDED) <= left, "add it to NEEDED"


@pytest.mark.parametrize(
    ("out", "remedy"),
    [
        ("closed/sheet.png", "permission denied"),
        ("file/sheet.png", "a file stands where a folder is needed"),
        ("circle/sheet.png", "a link to nothing"),
        ("x" * 300 + "/sheet.png", "the name is too long"),
        ("folder", "a folder: name a file"),
    ],
)
def test_what_cannot_be_written_is_told(
    ground: Path, monkeypatch, capfd: pytest.CaptureFixture[str], out: str, remedy: str
):
    monkeypatch.setattr(
        "racines_data.phantom.figures.contact_sheet",
        lambda phantom, path, seed: write_atomic(path, b"picture"),
    )
    monkeypatch.setattr("racines_data.phantom.Phantom", lambda config: None)
    code = run(monkeypatch, "study", "sheet", "--out", out)
    told = capfd.readouterr().err
    check_refused(told, code, out)
    assert code == 1 and out.split("/")[0] in told and remedy in told


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EROFS, errno.EDQUOT, errno.EIO])
def test_a_full_disk_names_the_file_that_was_written(
    tmp_path: Path, monkeypatch, capfd: pytest.CaptureFixture[str], number: int
):
    """The system names no file then: `write` knows a number."""

    def full(path: Path, *_: object) -> None:
        with naming(path):
            raise OSError(number, os.strerror(number))

    monkeypatch.setattr("racines_data.phantom.figures.contact_sheet", lambda p, out, s: full(out))
    monkeypatch.setattr("racines_data.phantom.Phantom", lambda config: None)
    assert run(monkeypatch, "study", "sheet", "--out", str(tmp_path / "a.png")) == 1
    told = capfd.readouterr().err
    check_refused(told, 1, "a.png")
    assert str(tmp_path / "a.png") in told and ":" in told


def test_a_failed_write_leaves_neither_half_a_file_nor_a_temporary_name(
    tmp_path: Path, monkeypatch
):
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device", str(tmp_path / ".a.json.x1y2"))

    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(OSError, match="No space left") as caught:
        write_atomic(tmp_path / "a.json", "{}")
    assert caught.value.filename == str(tmp_path / "a.json")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("error", "told"),
    [
        (FileNotFoundError("No such file (os error 2): x.parquet"), "x.parquet"),
        (OSError("Expected file path, but x is a directory"), "x is a directory"),
        (OSError(errno.ENOENT, "No such file", "a", None, "b"), "a to b: no such file"),
        (ConnectionRefusedError(errno.ECONNREFUSED, "Connection refused"), "connection"),
        (OSError(), "OSError: check the paths"),
        (PermissionError(errno.EACCES, "Permission denied", b"\xff/x"), "/x: permission denied"),
    ],
)
def test_each_error_has_a_remedy(error: OSError, told: str):
    line = describe_os_error(error)
    assert told in line and "\n" not in line and line.count(": ") >= 1
