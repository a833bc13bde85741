"""The workflows: nothing of a pull request's head is run, and every command in them exists."""

import json
import re
import shlex
from typing import Any

import pytest
import yaml
from typer.main import get_command

from racines_leaderboard.cli.command import app
from tests.conftest import ROOT

FOLDER = ROOT / ".github/workflows"
WORKFLOWS = sorted(FOLDER.glob("*.yml"))
PINNED = re.compile(r"[\w-]+/[\w-]+@(v\d+\.\d+\.\d+|[0-9a-f]{40})")
EVENT = re.compile(r"\$\{\{\s*(github\.(event|head_ref)[\w.]*|secrets\.[\w.]*)")


def read(name: str) -> dict[str, Any]:
    return yaml.safe_load((FOLDER / name).read_text())


def triggers(workflow: dict[Any, Any]) -> dict[str, Any]:
    return workflow[True]  # YAML 1.1 reads the key `on` so


def steps(workflow: dict[str, Any]) -> list[dict[str, Any]]:
    return [step for job in workflow["jobs"].values() for step in job["steps"]]


@pytest.mark.parametrize("path", WORKFLOWS, ids=[path.name for path in WORKFLOWS])
def test_no_workflow_has_more_than_it_needs(path):
    workflow = read(path.name)
    assert workflow["permissions"] == {"contents": "read"}
    assert not any("permissions" in job for job in workflow["jobs"].values())
    assert not {"pull_request_target", "workflow_run", "issue_comment"} & set(triggers(workflow))
    assert "secrets" not in path.read_text().replace("; secrets: none", "")
    for step in steps(workflow):
        if "uses" in step:
            assert PINNED.fullmatch(step["uses"]), step["uses"]
            if step["uses"].startswith("actions/checkout@"):
                assert step["with"]["persist-credentials"] is False
        # What somebody else may have written is never pasted into a script.
        assert not EVENT.search(step.get("run", "")), step


def test_ci_runs_what_the_project_runs():
    assert [step["run"] for step in steps(read("ci.yml")) if "run" in step] == [".ci/run"]


def test_ci_runs_every_test_once():
    """Those of `make test`, those marked to come after; each week the thorough ones.

    A long page is both thorough and of the documentation, so `make test-docs` runs all pages.
    """
    ran = re.findall(r"^ *make ([\w-]+)", (ROOT / ".ci/run").read_text(), re.MULTILINE)
    assert sorted(ran) == sorted(
        ["lint", "types", "repro", "test", "test-instruction-sets", "test-docs-quick"]
    )
    assert [step["run"] for step in steps(read("thorough.yml")) if "run" in step] == [
        "make test-thorough"
    ]
    for kind in ("exports", "clients"):
        [ran_weekly] = [step["run"] for step in steps(read(f"{kind}.yml")) if "run" in step]
        assert ran_weekly == f"make test-{kind}"
        assert "schedule" in triggers(read(f"{kind}.yml"))
    makefile = (ROOT / "Makefile").read_text()
    recipe = r"^{}: .*\n\t\$\(TESTS\) -m (.*)$"
    chosen = {
        name: re.findall(recipe.format(name), makefile, re.MULTILINE)
        for name in (
            "test",
            "test-instruction-sets",
            "test-docs",
            "test-docs-quick",
            "test-thorough",
        )
    }
    assert chosen == {
        "test": ['"not docs and not thorough and not instruction_sets"'],
        "test-instruction-sets": [
            '"instruction_sets and not thorough" $(call marked,instruction_sets)'
        ],
        "test-docs": ["docs $(call marked,docs)"],
        "test-docs-quick": ['"docs and not thorough" $(call marked,docs)'],
        "test-thorough": ["thorough"],
    }


def test_submissions_are_data_to_the_base_branchs_code():
    workflow = read("submission.yml")
    assert triggers(workflow) == {"pull_request": {"paths": ["leaderboard/submissions/**"]}}
    base, head = (s["with"] for s in steps(workflow) if "checkout" in s.get("uses", ""))
    assert base["ref"] == "${{ github.event.pull_request.base.sha }}" and "path" not in base
    assert head["ref"] == "${{ github.event.pull_request.head.sha }}"
    assert head["sparse-checkout"] == "leaderboard/submissions"
    for step in steps(workflow):
        for line in step.get("run", "").splitlines():
            if head["path"] in line:  # read by our command, compared, or named; never run
                assert re.match(r"racines submit |for folder|name=|diff -rq", line.strip()), line
    text = "\n".join(step.get("run", "") for step in steps(workflow))
    assert "--check" in text and "--recompute" in text and "GITHUB_STEP_SUMMARY" in text


def test_submissions_of_every_track_are_looked_at():
    schemas = ROOT / "leaderboard/racines_leaderboard/schemas"
    schema = json.loads((schemas / "submission.json").read_text())
    tracks = set(schema["properties"]["track"]["enum"])
    text = (FOLDER / "submission.yml").read_text()
    (looped,) = re.findall(r"/{([a-z,-]+)}/", text)
    (named,) = re.findall(r"\^\(([a-z|-]+)\)/", text)
    assert set(looped.split(",")) == set(named.split("|")) == tracks
    assert {path.name for path in (ROOT / "leaderboard/submissions").iterdir()} <= tracks


def test_submissions_are_scored_by_settings_that_make_their_boards():
    text = (FOLDER / "submission.yml").read_text()
    special = re.findall(r"\[\[ \$name == ([a-z*/-]+) \]\] && ground=\(--params (\S+)", text)
    boards = {"patient-*": "patients", "turn-*": "echo-rotation", "motion/*": "trackerless"}
    # The last that fits counts: motion over turns is no generator of turns.
    boards |= {"tracked-motion/*": "trackerless-tracked", "turn-motion/*": "trackerless-rotation"}
    assert [pattern for pattern, _ in special] == list(boards)
    for pattern, params in special:
        settings = yaml.safe_load((ROOT / params.rstrip(")")).read_text())
        assert boards[pattern] in (settings["board"], *settings.get("patient_boards", ()))


def commands() -> list[str]:
    runs = [step.get("run", "") for path in WORKFLOWS for step in steps(read(path.name))]
    return [found for run in runs for found in re.findall(r"racines [a-z][^;|>\n]*", run)]


@pytest.mark.parametrize("line", commands())
def test_every_command_and_option_exists(line):
    words = shlex.split(line.split(" 2>")[0])[1:]
    command: Any = get_command(app)
    while words and words[0] in getattr(command, "commands", {}):
        command = command.commands[words.pop(0)]
    known = {flag for parameter in command.params for flag in parameter.opts}
    given = [word for word in words if word.startswith("--")]
    assert not hasattr(command, "commands"), f"{line}: no such command"
    assert set(given) <= known, f"{line}: {set(given) - known}"


def test_there_are_commands_to_check():
    assert len(commands()) >= 5
