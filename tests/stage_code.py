"""What code each stage of `dvc.yaml` runs, and the dependencies that say so.

`python -m tests.stage_code` writes them into `dvc.yaml`: a folder for every room that a stage uses,
a file for what lies flat in a package or is one command among others.
"""

from functools import cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any

import yaml

from racines_data.config import read_params
from racines_envs.evaluation.agent_specs import find_entry
from racines_leaderboard.cli.command import COMMANDS
from tests.conftest import ROOT
from tests.modules import FOLDERS, closure, modules, says_only_what_it_offers

FILES = {f"{package}.cli" for package in FOLDERS}
"""Rooms whose modules have nothing to do with one another: a stage names the one that it runs."""


ON_PATIENTS = ("patient_agents", "evaluate_patients", "evaluate_beating")
"""Stages whose keys are agents on patients: the profile `patients` has all of them."""


def command_module(command: str) -> str:
    """Return the module that implements a command line `racines …`."""
    words = command.split()[1:]
    names = (" ".join(words[:count]) for count in range(len(words), 0, -1))
    return next(COMMANDS[name].partition(":")[0] for name in names if name in COMMANDS)


@cache
def registered(group: str) -> tuple[EntryPoint, ...]:
    """Return the entry points of a group; to read them takes long."""
    return tuple(entry_points(group=group))


def plugins(stage: str, key: str, params: dict[str, Any]) -> set[str]:
    """Return the modules of the plug-ins that a stage's key names."""
    names = {"racines.anatomies": {"heart"}, "racines.sources": set[str]()}
    if stage == "data":
        names["racines.sources"] = {params["data"]["source"], *params["data"]["also"]}
    if stage in ("generators", "scores"):
        names["racines.generators"] = {key}
    if stage in ("agents", "evaluate", *ON_PATIENTS):
        names["racines.agents"] = {find_entry(params, key).agent}
    return {
        point.module
        for group, wanted in names.items()
        for point in registered(group)
        if point.name in wanted
    }


@cache
def stage_code() -> dict[str, set[str]]:
    """Return the modules that each stage runs, over all keys of a profile, mostly the default."""
    found = {}
    for stage, content in yaml.safe_load((ROOT / "dvc.yaml").read_text())["stages"].items():
        params = read_params(profile="patients" if stage in ON_PATIENTS else "default")
        keys = params[content["foreach"].strip("${}")] if "foreach" in content else [""]
        command = content.get("do", content)["cmd"].replace("${key}", "KEY")
        starts = {command_module(command)}
        for key in keys:
            starts |= plugins(stage, key, params)
        found[stage] = closure(starts)
    return found


def dependency(module: str) -> Path | None:
    """Return what a stage names for a module: its folder or its file; None for mere names."""
    path = modules()[module]
    if says_only_what_it_offers(path):
        return None
    room = path.parent
    package = module.partition(".")[0]
    flat = room == FOLDERS[package] or ".".join(module.split(".")[:2]) in FILES
    return path if flat else room


def dependencies(code: set[str]) -> list[str]:
    """Return the dependencies of a stage that runs some modules, folders within others left out."""
    wanted = {path for module in code if (path := dependency(module)) is not None}
    shown = [path for path in wanted if not wanted & set(path.parents)]
    return [str(path.relative_to(ROOT)) for path in sorted(shown)]


@cache
def stage_places() -> dict[str, list[Path]]:
    """Return the folders and files of the code of each stage."""
    return {
        stage: [ROOT / each for each in dependencies(code)] for stage, code in stage_code().items()
    }


def stages_that_use(module: str) -> set[str]:
    """Return the stages that depend on a module's room, or on the module where it stands alone."""
    path = modules()[module]
    return {
        stage
        for stage, places in stage_places().items()
        if any(path.is_relative_to(each) for each in places)
    }


def is_code(dependency: str) -> bool:
    """Return whether a dependency is one of our packages' files or folders."""
    return any((ROOT / dependency).is_relative_to(folder) for folder in FOLDERS.values())


def write(path: Path) -> None:
    """Write the code of every stage into its `deps`; what else stands there stays."""
    from ruamel.yaml import YAML

    editor = YAML()
    editor.width, editor.preserve_quotes = 100, True
    editor.indent(mapping=2, sequence=4, offset=2)
    content = editor.load(path.read_text(encoding="utf-8"))
    for name, code in stage_code().items():
        stage = content["stages"][name]
        stage = stage.get("do", stage)
        stage["deps"] = [each for each in stage["deps"] if not is_code(each)] + dependencies(code)
    with path.open("w", encoding="utf-8") as file:
        editor.dump(content, file)


if __name__ == "__main__":
    write(ROOT / "dvc.yaml")
