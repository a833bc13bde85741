"""How it is installed elsewhere: files for containers and conda, and systems that are not Linux."""

import json
import os
import re
import sys
import tomllib
from pathlib import Path

import pytest
import yaml

from racines_data.build.dataset import peak_memory
from racines_data.errors import RacinesError
from racines_data.files import locked
from racines_envs.driving.keyboard import Terminal
from racines_leaderboard.submissions.confined import Child, Limits
from tests.conftest import ROOT
from tests.modules import modules

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
PYTHONS = {
    each.rpartition(" ")[2] for each in PROJECT["classifiers"] if re.search(r":: 3\.\d+$", each)
}
POSIX_ONLY = ("fcntl", "grp", "pwd", "pty", "resource", "termios", "tty")


def check_extras(named: str) -> None:
    assert set(named.split(",")) <= set(PROJECT["optional-dependencies"]), named


def test_conda_installs_this_package_on_a_python_that_it_has():
    told = yaml.safe_load((ROOT / "environment.yml").read_text())
    python, pip, lines = told["dependencies"]
    assert python.removeprefix("python=") in PYTHONS and pip == "pip"
    constraint, editable = lines["pip"]
    assert (ROOT / constraint.removeprefix("--constraint=")).is_file()
    check_extras(re.fullmatch(r"--editable=\.\[(.+)\]", editable)[1])  # type: ignore[index]


def test_the_images_have_a_python_and_what_they_copy():
    lines = (ROOT / "Dockerfile").read_text().splitlines()
    commands = [line.split(maxsplit=1) for line in lines if line and not line.startswith("#")]
    known = {"FROM", "ARG", "COPY", "RUN", "USER", "WORKDIR", "ENTRYPOINT", "CMD"}
    assert {name for name, _ in commands} <= known
    stages = {}
    for name, rest in commands:
        if name == "FROM":
            image, _, stage = rest.split()
            stages[stage] = image
        elif name == "ARG" and rest.startswith("EXTRAS="):
            check_extras(rest.removeprefix("EXTRAS="))
        elif name == "COPY":
            kept = (ROOT / ".dockerignore").read_text().splitlines()
            for path in rest.split()[:-1]:
                assert (ROOT / path).exists() and f"!{path}" in kept
        elif name in ("ENTRYPOINT", "CMD"):
            assert json.loads(rest)
    assert all(
        re.fullmatch(r"python:(3\.\d+)(-slim)?", image)[1] in PYTHONS  # type: ignore[index]
        for image in stages.values()
    )
    container = json.loads((ROOT / ".devcontainer/devcontainer.json").read_text())
    build = container["build"]
    assert (ROOT / ".devcontainer" / build["dockerfile"]).resolve() == ROOT / "Dockerfile"
    assert build["target"] in stages
    assert f"useradd --create-home {container['remoteUser']}" in "\n".join(lines)
    assert container["postCreateCommand"] == "make .venv/.ready"


def test_nothing_that_windows_lacks_is_imported_with_a_module():
    lacking = re.compile(rf"^(import|from) ({'|'.join(POSIX_ONLY)})\b", re.MULTILINE)
    assert not [name for name, path in modules().items() if lacking.search(path.read_text())]


@pytest.mark.parametrize(
    ("system", "unconfined", "told"),
    [
        ("win32", False, r"x\.onnx: Windows \(win32\).*run it on Linux"),
        ("win32", True, r"x\.onnx: Windows \(win32\).*run it on Linux"),
        ("darwin", False, r"x\.onnx: nothing here can confine.*darwin.*--unconfined"),
    ],
)
def test_a_strangers_file_is_refused_by_the_systems_name(
    monkeypatch: pytest.MonkeyPatch, system: str, unconfined: bool, told: str
):
    monkeypatch.setattr(sys, "platform", system)
    with pytest.raises(RacinesError, match=told):
        Child("onnx", b"", "x.onnx", Limits(unconfined=unconfined))


def test_windows_is_told_how_to_drive_and_counts_no_memory(monkeypatch: pytest.MonkeyPatch):
    assert peak_memory(1) > 1e7
    monkeypatch.setattr(sys, "platform", "win32")
    monkeypatch.setattr(os, "isatty", lambda descriptor: True)
    with pytest.raises(RacinesError, match=r"win32.*--keys.*racines studio"):
        Terminal()
    assert peak_memory(1) == 0


def test_a_lock_is_let_go_where_open_files_cannot_be_removed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    def refuse(path: Path, missing_ok: bool = False) -> None:
        raise PermissionError(13, "in use", str(path))

    monkeypatch.setattr(Path, "unlink", refuse)
    for _ in range(2):
        with locked(tmp_path, seconds=1):
            pass
