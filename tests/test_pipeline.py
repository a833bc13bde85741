"""The pipeline's shape: what runs, in which order, and what a change makes run again.

The stages run for real under DVC in a scratch repository, with a stand-in for `racines` that fills
each stage's outputs with a digest of that stage's dependencies and parameters, in no time.
"""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml

from racines_data.config import PROFILES, read_params
from racines_data.views import VIEWS
from racines_envs.agents import agent_names
from racines_envs.evaluation.agent_specs import find_entry
from racines_models.registry import generator_names
from tests.conftest import ROOT
from tests.modules import closure, modules, says_only_what_it_offers
from tests.stage_code import is_code, stage_code, stages_that_use

STAND_IN = """#!{python}
import hashlib, json, pathlib, sys, time
command = " ".join(["racines", *sys.argv[1:]])
stages = json.loads(pathlib.Path("stages.json").read_text())
stage, needed = stages[command], [dep for each in stages.values() for dep in each["deps"]]
with open("ran.txt", "a") as log:
    log.write(stage["name"] + "\\n")
if pathlib.Path("stop", stage["name"]).exists():
    sys.exit("told to fail")
while pathlib.Path("wait", stage["name"]).exists():
    time.sleep(0.1)
digest = hashlib.sha256(json.dumps(stage["params"]).encode())
for path in map(pathlib.Path, stage["deps"]):
    files = [path] if path.is_file() else sorted(p for p in path.rglob("*") if p.is_file())
    for file in files:
        digest.update(file.read_bytes())
for out in map(pathlib.Path, stage["outs"]):
    # In a folder what other stages need of it, and one file more.
    within = [path for path in map(pathlib.Path, needed) if out in path.parents]
    for path in [out] if out.suffix else [out / "out.txt", *within]:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps({{"digest": digest.hexdigest()}}))
"""


def run(folder: Path, *command: str) -> str:
    environment = os.environ | {
        "PATH": os.pathsep.join(
            [str(folder / "bin"), str(Path(sys.executable).parent), os.environ["PATH"]]
        )
    }
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def stages(folder: Path) -> dict[str, dict[str, Any]]:
    """Return DVC's own reading of the pipeline: by command, what the stage reads and writes."""
    from dvc.repo import Repo

    found = {}
    with Repo(str(folder)) as repo:
        for stage in repo.index.stages:
            deps = [d for d in stage.deps if type(d).__name__ != "ParamsDependency"]
            params = [d for d in stage.deps if type(d).__name__ == "ParamsDependency"]
            found[str(stage.cmd)] = {
                "name": stage.name,
                "deps": [str(dep.def_path) for dep in deps],
                "outs": [str(out.def_path) for out in stage.outs],
                "cached": [str(out.def_path) for out in stage.outs if out.use_cache],
                "params": [dep.read_params() for dep in params],
            }
    return found


@pytest.fixture(scope="module")
def reproduced(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[str]]:
    """A scratch repository with the pipeline, its code and the stand-in, run once; what ran."""
    folder = scratch(tmp_path_factory.mktemp("pipeline"))
    return folder, repro(folder)


def scratch(tmp_path: Path) -> Path:
    """Make a folder a repository with the pipeline, its code and the stand-in; return it."""
    for name in ("dvc.yaml", "params.yaml", ".dvcignore", "Makefile"):
        shutil.copy(ROOT / name, tmp_path / name)
    for name in ("racines_data", "models/racines_models", "envs/racines_envs"):
        skip = shutil.ignore_patterns("__pycache__")
        shutil.copytree(ROOT / name, tmp_path / name, ignore=skip)
    shutil.copytree(
        ROOT / "leaderboard",
        tmp_path / "leaderboard",
        ignore=shutil.ignore_patterns("__pycache__", "results"),
    )
    for name in ("models/weights/grader", "models/weights/pose"):
        shutil.copytree(ROOT / name, tmp_path / name)
    for name in ("models/weights/phantom-default", "envs/weights/phantom-default"):
        (tmp_path / name).mkdir(parents=True)
        (tmp_path / name / "weights").write_text("published")
    run(tmp_path, "git", "init", "-q")
    run(tmp_path, "dvc", "init", "-q")
    shutil.copy(ROOT / ".dvc/config", tmp_path / ".dvc/config")
    (tmp_path / "bin").mkdir()
    stand_in = tmp_path / "bin" / "racines"
    stand_in.write_text(STAND_IN.format(python=sys.executable))
    stand_in.chmod(0o755)
    return tmp_path


def repro(folder: Path) -> list[str]:
    """Run the pipeline; return the stages that ran, in order."""
    log = folder / "ran.txt"
    log.unlink(missing_ok=True)
    (folder / "stages.json").write_text(json.dumps(stages(folder)))
    run(folder, "dvc", "repro", "-q")
    return log.read_text().split() if log.exists() else []


def change(folder: Path, path: str, value: object) -> None:
    params = yaml.safe_load((folder / "params.yaml").read_text())
    node = params
    *parents, last = path.split(".")
    for key in parents:
        node = node[key]
    assert node.get(last) != value
    node[last] = value
    (folder / "params.yaml").write_text(yaml.safe_dump(params, sort_keys=False))


@pytest.mark.thorough
def test_a_change_runs_again_what_follows_from_it_and_nothing_else(
    reproduced: tuple[Path, list[str]],
):
    pipeline, everything = reproduced
    assert everything[0] == "data" and everything[-1] == "leaderboard"
    assert set(everything) == {stage["name"] for stage in stages(pipeline).values()}
    assert repro(pipeline) == [], "a second repro does nothing"

    change(pipeline, "generators.vae-gan.learning_rate", 0.5)
    assert repro(pipeline) == [
        "generators@vae-gan",
        "scores@vae-gan",
        "gallery",
        "leaderboard",
    ]

    change(pipeline, "agents.ppo.actor_lr", 0.5)
    assert repro(pipeline) == ["agents@ppo", "evaluate@ppo", "leaderboard"]

    change(pipeline, "patient_agents.constant-pose.patients", 9)
    assert repro(pipeline) == [
        "patient_agents@constant-pose",
        "evaluate_patients@constant-pose",
        "evaluate_beating@constant-pose",
    ]

    entry = {"agent": "ppo", "view": "PL"}
    change(pipeline, "agents.ppo-pl", entry)
    assert repro(pipeline) == ["agents@ppo-pl", "evaluate@ppo-pl", "leaderboard"]

    (pipeline / "racines_data" / "README.md").write_text("words")
    shutil.rmtree(pipeline / "data" / "racines")
    assert repro(pipeline) == [], "documentation is no dependency; data come from the cache"
    assert (pipeline / "data" / "racines" / "out.txt").is_file()


def test_params_yaml_is_the_default_profile():
    profile = ROOT / "racines_data" / "profiles" / "default.yaml"
    assert (ROOT / "params.yaml").read_bytes() == profile.read_bytes()


OF_STUDIES = {"downstream"}
"""Sections that no stage reads: a study's settings, in those profiles that measured with it."""


def test_profiles_have_the_same_sections():
    contents = {
        name: yaml.safe_load((ROOT / "racines_data" / "profiles" / f"{name}.yaml").read_text())
        for name in PROFILES
    }
    default = contents["default"]
    boards = {name: f"phantom-{name}" for name in PROFILES} | {"abdomen": "abdomen-smoke"}
    for name, content in contents.items():
        assert content["board"] == boards[name]
        assert [each for each in content if each not in OF_STUDIES] == list(default)
        assert {"random", "planner", "ppo"} <= set(content["agents"])


ON_PATIENTS = {"constant-pose", "blind-tour", "servo", "servo-memory", "ppo-belief"}
"""Agents that know patients only."""
OF_OTHERS = {"onnx", "servo-ensemble"}
"""Agents made of a file, or of another's trainings."""


def test_the_profile_of_patients_runs_every_agent_that_knows_them():
    params = read_params(profile="patients")
    entries = [find_entry(params, run) for run in params["patient_agents"]]
    assert {entry.agent for entry in entries} == ON_PATIENTS | {"planner"}
    assert {entry.section for entry in entries} == {"patient_agents"}
    for name in PROFILES:
        runs = read_params(profile=name)["patient_agents"]
        assert set(runs) <= set(params["patient_agents"]), "what the stages depend on"
        assert not set(runs) & set(read_params(profile=name)["agents"]), "one folder a run"


def test_the_first_look_has_patients():
    for name in ("smoke", "default", "patients"):
        params = read_params(profile=name)
        assert params["data"]["also"] == ["patients", "beating"]
        assert "constant-pose" in params["patient_agents"]


@pytest.mark.parametrize("name", ["smoke", "reference"])
def test_the_first_and_the_last_profile_run_every_agent(name: str):
    """One to see that all run, the other for the published table, on every view."""
    params = read_params(profile=name)
    entries = [find_entry(params, run) for run in params["agents"]]
    assert {entry.agent for entry in entries} == set(agent_names()) - ON_PATIENTS - OF_OTHERS
    if name == "reference":
        seen = {(entry.agent, entry.view or "SC") for entry in entries}
        assert seen >= {(agent, view) for agent in ("random", "planner", "ppo") for view in VIEWS}
        shown = {each.settings.get("observation") for each in entries if each.agent == "ppo"}
        assert shown == {None, "image", "multimodal"}


def test_the_reference_profile_trains_every_generator():
    """The published table has all rows; other profiles train some."""
    registered = set(generator_names())
    for name in PROFILES:
        params = read_params(profile=name)
        generators, adapting = set(params["generators"]), set(params["patient_generators"])
        assert generators <= registered
        # What draws only patients that it has scouted has no row on the one heart's board.
        assert name != "reference" or generators | adapting == registered


def test_every_stage_is_a_plain_command_of_ours():
    pipeline = yaml.safe_load((ROOT / "dvc.yaml").read_text())["stages"]
    for name, stage in pipeline.items():
        command = stage.get("do", stage)["cmd"]
        assert command.startswith("racines ") and "dvc" not in command, name
    assert list(pipeline) == [
        "data",
        "patient_agents",
        "evaluate_patients",
        "evaluate_beating",
        "grader",
        "student",
        "pose",
        "encoder",
        "generators",
        "scores",
        "gallery",
        "agents",
        "evaluate",
        "realism",
        "leaderboard",
    ]


def test_realism_reports_on_both_configs():
    stage = yaml.safe_load((ROOT / "dvc.yaml").read_text())["stages"]["realism"]
    reports = ("models/runs/realism.json", "models/runs/realism-multi_phantom.json")
    assert stage["metrics"] == [{report: {"cache": False}} for report in reports]
    shown = [report.replace(".json", ".png") for report in reports]
    done = subprocess.run(["git", "check-ignore", *shown], cwd=ROOT, capture_output=True, text=True)
    assert done.stdout.split() == shown


def test_what_dvc_caches_is_ignored_by_git():
    """DVC writes .gitignore lines for what it caches; they are committed, so repro adds none."""
    cached = [out for stage in stages(ROOT).values() for out in stage["cached"]]
    assert "data/racines" in cached and "models/runs/vae-gan" in cached
    done = subprocess.run(
        ["git", "check-ignore", *cached], cwd=ROOT, capture_output=True, text=True
    )
    assert done.stdout.split() == cached


def test_runs_of_every_profile_are_ignored_by_git():
    """So that a switch of profile leaves nothing that a commit would take along."""
    contents = [read_params(profile=profile) for profile in PROFILES]
    names = {name for content in contents for name in content["agents"]}
    others = {name for content in contents for name in content["patient_agents"]}
    paths = [f"envs/runs/{name}" for name in sorted(names)]
    paths += [f"envs/runs/scores/{name}.png" for name in sorted(names)] + ["models/runs/encoder"]
    paths += [f"envs/runs/{name}" for name in [*sorted(others), "servo-frames", "memory-episodes"]]
    done = subprocess.run(["git", "check-ignore", *paths], cwd=ROOT, capture_output=True, text=True)
    assert done.stdout.split() == paths


STAGES = stage_code()


@pytest.mark.parametrize("stage", STAGES)
def test_a_stage_depends_on_the_code_that_it_runs_and_on_no_other(stage: str):
    """`python -m tests.stage_code` writes the dependencies of all stages anew."""
    written = yaml.safe_load((ROOT / "dvc.yaml").read_text())["stages"][stage]
    deps = [ROOT / dep for dep in written.get("do", written)["deps"] if is_code(dep)]
    files = {modules()[name] for name in STAGES[stage]}
    needed = {path for path in files if not says_only_what_it_offers(path)}
    missing = {path for path in needed if not any(path.is_relative_to(dep) for dep in deps)}
    assert not missing, f"{stage} runs what it does not depend on: {sorted(map(str, missing))}"
    idle = {dep for dep in deps if not any(path.is_relative_to(dep) for path in needed)}
    assert not idle, f"{stage} depends on what it does not run: {sorted(map(str, idle))}"


def test_the_closure_sees_what_runs():
    """Lazy imports count where a module is used, not where it is merely a parent on the way."""
    assert "racines_models.judges.grader.training" in STAGES["grader"]  # imported in the command
    assert "racines_data.hub.fetch" in closure(["racines_data.load"])
    assert "racines_data.hub.fetch" not in closure(["racines_data.schema"])
    assert "racines_models.generators.vae_gan" in STAGES["generators"]
    assert "racines_models.generators.flow" not in STAGES["generators"]  # in no default profile
    right = ("racines_leaderboard.", "racines_envs.")
    for stage in ("grader", "student", "pose", "generators", "scores", "gallery"):
        assert not {name for name in STAGES[stage] if name.startswith(right)}
    for stage in set(STAGES) - {"leaderboard"}:
        assert not {name for name in STAGES[stage] if name.startswith(right[0])}


TOUCHED = [
    "racines_data.schema",
    "racines_data.phantom.truth",
    "racines_data.sources.phantom",
    "racines_data.store.frames",
    "racines_data.build.writer",
    "racines_data.card.markdown",
    "racines_data.export.release",
    "racines_data.hub.push",
    "racines_data.validate.survey",
    "racines_data.cli.dataset",
    "racines_models.weights",
    "racines_models.networks.pyramid",
    "racines_models.training.trainer",
    "racines_models.exchange.onnx.generator",
    "racines_models.generators.flow",
    "racines_models.judges.grader.report",
    "racines_models.judges.student.training",
    "racines_models.judges.pose.regressor",
    "racines_models.scores.metrics",
    "racines_models.studies.leakage",
    "racines_models.cli.train.pose",
    "racines_envs.recordings.minari",
    "racines_envs.task.rewards",
    "racines_envs.worlds.making",
    "racines_envs.apis.rendering",
    "racines_envs.agents.ppo",
    "racines_envs.driving.keyboard",
    "racines_envs.evaluation.measures",
    "racines_envs.explain.maps",
    "racines_envs.recordings.episodes",
    "racines_envs.studies.curves",
    "racines_leaderboard.board.rank",
    "racines_leaderboard.records.schema",
    "racines_leaderboard.submissions.intake",
    "racines_leaderboard.expert.agreement",
    "racines_leaderboard.audit.claims",
    "racines_leaderboard.studio.app",
]
"""One module in each room."""


@pytest.mark.thorough
def test_a_touched_module_runs_the_stages_that_use_its_room_and_no_others(
    reproduced: tuple[Path, list[str]],
):
    from dvc.repo import Repo

    pipeline, _ = reproduced
    assert repro(pipeline) == []
    for module in TOUCHED[4::6]:  # DVC takes seconds each; dvc.yaml is held to the code above
        path = pipeline / modules()[module].relative_to(ROOT)
        path.write_text(path.read_text() + "# touched\n")
        with Repo(str(pipeline)) as repo:
            status = repo.status()
        path.write_text(modules()[module].read_text())
        changed = {name.rpartition(":")[2].partition("@")[0] for name in status}
        assert changed == stages_that_use(module), module


def test_what_trains_nothing_retrains_nothing():
    trained = {"grader", "student", "pose", "encoder", "generators", "agents"}
    for module in modules():
        if module.startswith("racines_leaderboard."):
            assert not stages_that_use(module) & trained, module
