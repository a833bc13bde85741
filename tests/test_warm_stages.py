"""A stage that is a fork is the command: its words, folder, environment, streams and exit code."""

import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.conftest import ROOT
from tests.waiting import PATIENCE

SERVER = "import sys; from pathlib import Path; from tests import warm_stages as w; w.run({})"
Program = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture
def server(tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    source = SERVER.format("Path(sys.argv[1]), 'racines_leaderboard.cli.command'")
    words = [sys.executable, "-c", source, str(tmp_path)]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen(words, cwd=ROOT, text=True, **pipes) as server:
        assert server.stdout is not None
        assert server.stdout.readline().strip() == str(tmp_path / "racines")
        yield server


def call(tmp_path: Path, *words: str, **told: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [str(tmp_path / "racines"), *words], cwd=tmp_path, env=told, capture_output=True, text=True
    )


@pytest.mark.thorough
def test_it_is_the_command_and_ends_with_who_started_it(server, tmp_path: Path):
    done = call(tmp_path, "--version")
    assert (done.returncode, done.stderr) == (0, "") and done.stdout.startswith("racines ")
    (tmp_path / "mine.yaml").write_text(
        "data: {sead: 1}"
    )  # found from where the command was called
    done = call(tmp_path, "data", "build", "--params", "mine.yaml")
    assert (done.returncode, done.stdout) == (1, "")
    assert "racines: mine.yaml" in done.stderr and "sead" in done.stderr
    assert call(tmp_path, "data", "bild").returncode == 2
    narrow, wide = (call(tmp_path, "--help", COLUMNS=each).stdout for each in ("50", "100"))
    assert len(narrow.splitlines()) > len(wide.splitlines()) > 20
    server.stdin.close()
    assert server.wait(PATIENCE) == 0
    assert call(tmp_path, "--version").returncode == 1
