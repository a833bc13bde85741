"""The wheel, installed where no repository is: the command, a load, an environment step.

The clean environment gets our wheel and nothing else from pip; the libraries that it needs come
from the environment that runs the tests, by a .pth file. That leaves out pip's download of
gigabytes and nothing of ours: the test checks that every package comes from the wheel.
"""

import json
import os
import subprocess
import sys
import sysconfig
import venv
import zipfile
from pathlib import Path

import pytest

import hatch_build
from tests.conftest import ROOT

CHECK = """
import pathlib, sys
import racines_data, racines_models, racines_envs, racines_leaderboard
for package in (racines_data, racines_models, racines_envs, racines_leaderboard):
    assert pathlib.Path(package.__file__).is_relative_to(sys.prefix), package.__file__
frames = racines_data.load(root=sys.argv[1], split="train")
assert frames[0]["image"].size == (128, 128)
import gymnasium
env = gymnasium.make("racines_envs:racines/SC-v0")  # the default reward asks the grader
observation, info = env.reset(seed=0)
observation, reward, *_ = env.step(env.action_space.sample())
assert observation.shape == (128, 128, 1), observation.shape
assert env.unwrapped.core.grader.architecture == "student"
print("fine")
"""


def run(folder: Path, *words: str | Path) -> str:
    # Nothing of the repository is told of: neither its code nor its metadata.
    bare = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    words = tuple(map(str, words))
    done = subprocess.run(words, cwd=folder, capture_output=True, text=True, env=bare)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    build = ("pip", "wheel", "-q", "--no-deps", "--no-build-isolation", "-w", folder)
    run(folder, sys.executable, "-m", *build, ROOT)
    return next(folder.glob("racines-*.whl"))


@pytest.mark.slow
def test_the_wheel_holds_the_packages_and_their_data_and_nothing_else(wheel: Path):
    names = zipfile.ZipFile(wheel).namelist()
    tops = {name.split("/")[0] for name in names if ".dist-info" not in name}
    assert tops == {"racines_data", "racines_models", "racines_envs", "racines_leaderboard"}
    for name in (
        "racines_data/profiles/smoke.yaml",
        "racines_data/py.typed",
        "racines_leaderboard/schemas/record.json",
        "racines_leaderboard/schemas/expert-kit.json",
        "racines_leaderboard/published.json",
        "racines_leaderboard/studio/studio.css",
    ):
        assert name in names
    inside = "racines_models/published/carried/"
    carried = {name.removeprefix(inside) for name in names if name.startswith(inside)}
    assert carried == {path for place in hatch_build.CARRIED for path in tracked(place)}
    assert sum(name.endswith(".safetensors") for name in names) == len(
        [name for name in carried if name.endswith(".safetensors")]
    ), "in one place, once"


def tracked(place: str) -> set[str]:
    told = subprocess.run(["git", "ls-files", place], cwd=ROOT, capture_output=True, text=True)
    return set(told.stdout.split())


@pytest.mark.docs
@pytest.mark.slow
def test_the_installed_wheel_works_outside_the_repository(
    wheel: Path, tmp_path: Path, tiny_root: Path
):
    venv.create(tmp_path / "env", with_pip=False)
    python = tmp_path / "env" / "bin" / "python"
    install = ("install", "-q", "--no-deps", "--no-index")
    run(tmp_path, sys.executable, "-m", "pip", "--python", python, *install, wheel)
    # Only now, or pip would take the outer environment's racines for one to replace. A .pth file
    # in a folder that a .pth file adds is not read, so the editable install stays out.
    site = run(tmp_path, python, "-c", "import site; print(site.getsitepackages()[0])").strip()
    Path(site, "libraries.pth").write_text(sysconfig.get_path("purelib") + "\n", encoding="utf-8")
    racines, empty = tmp_path / "env/bin/racines", tmp_path / "empty"
    empty.mkdir()
    assert "Usage: racines" in run(empty, racines, "--help")
    assert run(empty, python, "-c", CHECK, tiny_root).endswith("fine\n")
    listed = json.loads(run(empty, racines, "weights", "list", "--json"))["weights"]
    assert {each["name"] for each in listed} == {"student", "ppo", "servo"}
    assert "more come with a checkout" in run(empty, racines, "weights", "list")
    assert "all as published" in run(empty, racines, "weights", "verify")
    doctor = run(empty, racines, "doctor")
    assert "Nothing is broken." in doctor and "racines demo" in doctor
    # Without a dataset, a params file or a run: the published agent and the student's judgement.
    scored = json.loads(
        run(empty, racines, "eval", "agent", "ppo", "--view", "SC", "--starts", "2", "--json")
    )
    assert scored["agent"] == "ppo-2-starts" and scored["metrics"]["success_true"]["value"] == 1.0
    assert (empty / "envs/runs/scores").is_dir()
    run(empty, racines, "demo", "--seed", "0", "--patient", "20035")
    assert (empty / "demo/index.html").is_file()
