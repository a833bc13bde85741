"""`make repro` runs stages side by side, each once, and stops with whichever fails."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.test_pipeline import repro, scratch, stages


def make_repro(folder: Path) -> subprocess.CompletedProcess[str]:
    """Run `make repro` with the stand-in, in a scratch repository."""
    path = os.pathsep.join(
        [str(folder / "bin"), str(Path(sys.executable).parent), os.environ["PATH"]]
    )
    set_up = folder / ".venv" / ".ready"
    command = ["make", "-o", str(set_up), f"READY={set_up}", f"PATH={path}", "repro"]
    (folder / "stages.json").write_text(json.dumps(stages(folder)))
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=300)


@pytest.mark.thorough
def test_make_runs_stages_side_by_side_each_once_and_after_what_it_reads(tmp_path: Path):
    pipeline = scratch(tmp_path)
    done = make_repro(pipeline)
    assert done.returncode == 0, done.stdout + done.stderr
    ran, known = (pipeline / "ran.txt").read_text().split(), stages(pipeline).values()
    assert sorted(ran) == sorted(stage["name"] for stage in known)
    made = {Path(out): stage["name"] for stage in known for out in stage["outs"]}
    for stage in known:
        for dep in map(Path, stage["deps"]):
            for name in {made[each] for each in (dep, *dep.parents) if each in made}:
                assert ran.index(name) < ran.index(stage["name"])
    between = ran[ran.index("grader") : ran.index("pose")]
    assert any(name.startswith("generators@") for name in between), "one half after the other"
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
