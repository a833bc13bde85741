"""`make repro` runs stages side by side, each once, and stops with whichever fails."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

from tests.test_pipeline import repro, scratch, stages


def start(folder: Path) -> subprocess.Popen[str]:
    """Start `make repro` with the stand-in, in a scratch repository."""
    path = os.pathsep.join(
        [str(folder / "bin"), str(Path(sys.executable).parent), os.environ["PATH"]]
    )
    set_up = folder / ".venv" / ".ready"
    command = ["make", "-o", str(set_up), f"READY={set_up}", f"PATH={path}", "repro"]
    (folder / "stages.json").write_text(json.dumps(stages(folder)))
    pipe = subprocess.PIPE
    return subprocess.Popen(command, cwd=folder, stdout=pipe, stderr=pipe, text=True)


def make_repro(folder: Path) -> subprocess.CompletedProcess[str]:
    """Run it to its end."""
    with start(folder) as started:
        out, err = started.communicate(timeout=300)
        return subprocess.CompletedProcess(started.args, started.returncode, out, err)


def await_stages(started: subprocess.Popen[str], folder: Path, names: set[str]) -> None:
    """Wait until stages have begun."""
    ran, until = folder / "ran.txt", time.monotonic() + 120
    while not names <= set(ran.read_text().split() if ran.is_file() else ()):
        assert time.monotonic() < until and started.poll() is None
        time.sleep(0.2)


@pytest.mark.thorough
def test_make_runs_stages_side_by_side_each_once_and_after_what_it_reads(tmp_path: Path):
    pipeline = scratch(tmp_path)
    (pipeline / "wait").mkdir()
    held = pipeline / "wait/encoder"
    held.touch()
    started = start(pipeline)
    # The encoder ends only once a generator has run beside it.
    await_stages(started, pipeline, {"encoder", "generators@vae-gan"})
    held.unlink()
    out, err = started.communicate(timeout=300)
    assert started.returncode == 0, out + err
    ran, known = (pipeline / "ran.txt").read_text().split(), stages(pipeline).values()
    assert sorted(ran) == sorted(stage["name"] for stage in known)
    made = {Path(out): stage["name"] for stage in known for out in stage["outs"]}
    for stage in known:
        for dep in map(Path, stage["deps"]):
            for name in {made[each] for each in (dep, *dep.parents) if each in made}:
                assert ran.index(name) < ran.index(stage["name"])
    assert repro(pipeline) == [], "DVC finds all of it up to date"


@pytest.mark.thorough
@pytest.mark.parametrize("failing, other", [("grader", "generators@mean-image"), ("gallery", "")])
def test_make_fails_with_a_stage_of_either_half_and_leaves_nothing_running(
    tmp_path: Path, failing: str, other: str
):
    pipeline = scratch(tmp_path)
    for folder, name in (("stop", failing), ("wait", other)):
        (pipeline / folder).mkdir()
        (pipeline / folder / (name or "none")).touch()
    done = make_repro(pipeline)  # it returns though the other half would wait for ever
    assert done.returncode != 0 and f"failed to reproduce '{failing}'" in done.stderr
    ran = (pipeline / "ran.txt").read_text().split()
    assert failing in ran and "leaderboard" not in ran


@pytest.mark.thorough
def test_who_stops_make_stops_both_halves(tmp_path: Path):
    pipeline = scratch(tmp_path)
    (pipeline / "wait").mkdir()
    for name in ("grader", "generators@mean-image"):
        (pipeline / "wait" / name).touch()
    started = start(pipeline)
    await_stages(started, pipeline, {"grader", "generators@mean-image"})
    started.terminate()
    started.communicate(timeout=60)
    until = time.monotonic() + 30
    while left := [one for one in psutil.process_iter(["cwd"]) if one.info["cwd"] == str(pipeline)]:
        assert time.monotonic() < until, left
        time.sleep(0.2)
