"""The `racines` command as a shell sees it."""

import json
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer.main
from typer.testing import CliRunner

from racines_leaderboard.cli import renamed
from racines_leaderboard.cli.command import COMMANDS, GROUPS, app, main
from tests.conftest import command
from tests.leaderboard.conftest import generator_scores, write_submission

HELP = ["", *GROUPS, *COMMANDS]


@pytest.mark.parametrize("words", HELP)
def test_help(words: str):
    done = CliRunner().invoke(app, [*words.split(), "--help"], prog_name="racines")
    assert done.exit_code == 0 and f"Usage: racines {words}" in done.stdout


def test_commands_and_options_are_few_and_are_found_by_what_a_user_wants():
    """A study more is no command more. The last that came bring one's own: `data map`, `data
    inspect`, `phantom from-mesh`, `phantom from-labels`, `export envhub`; and a track of its own,
    motion: `train motion`, `eval motion`, `export motion`. Two options say who runs the tasks, and
    where: `--engine`, `--address`. Then the first hour: `demo`, `doctor` and its `--full`, `weights
    list`, `verify`, `card`, `fetch`, and typer's two options of completion. `weights push`
    sends what `weights fetch --hub` takes; `--cards` shows what a Hub would. And `--quiet`.
    """
    assert sum(not words.startswith("study ") for words in COMMANDS) <= 53
    assert len({name for name, _ in _options()}) <= 148


def test_an_option_says_the_same_everywhere():
    told: dict[str, set[str]] = {}
    for name, text in _options():
        told.setdefault(name, set()).add(text)
    shared = "data params profile device json force grader no-grader pose no-pose resume split set "
    shared += "results submissions details backend observation starts run runs strict reward view "
    shared += "secret quiet"
    assert {name: told[f"--{name}"] for name in shared.split() if len(told[f"--{name}"]) > 1} == {}
    for name in ("--out", "--seed"):  # what is written, and what is drawn, differ by kind
        assert len(told[name]) <= 5


def _options() -> list[tuple[str, str]]:
    def walk(command: Any) -> Iterator[Any]:
        for each in getattr(command, "commands", {}).values():
            yield from walk(each)
        yield from command.params

    found = walk(typer.main.get_command(app))
    return [(each.opts[0], each.help) for each in found if each.param_type_name == "option"]


@pytest.mark.parametrize("old", renamed.COMMANDS)
def test_an_old_name_works_and_says_the_new_one(old: str):
    new = renamed.COMMANDS[old]
    done = CliRunner().invoke(app, [*old.split(), "--help"], prog_name="racines")
    assert done.exit_code == 0
    assert done.stderr == f"racines: {old} is an old name of: {new}\n"
    name = new.partition(" --")[0]
    assert name in COMMANDS and f"Usage: racines {name} " in done.stdout
    assert old not in COMMANDS, "an old name is in no list of --help"


def test_old_options_work_and_say_the_new_ones(capsys: pytest.CaptureFixture[str]):
    words = ["eval", "agent", "ppo", "--run-dir=a", "--scores", "b.json", "--view", "SC"]
    new = ["eval", "agent", "ppo", "--run=a", "--out", "b.json", "--view", "SC"]
    assert renamed.renamed(words) == new
    assert capsys.readouterr().err.splitlines() == [
        "racines: --run-dir is an old name of: --run",
        "racines: --scores is an old name of: --out",
    ]
    assert renamed.renamed(["expert", "oracle", "kit", "--grader"])[-2:] == ["kit", "--by=grader"]
    assert renamed.renamed(new) == new and renamed.renamed(["--version"]) == ["--version"]
    set_now = [f"--set=steps={n}" for n in (4, 5)]
    assert renamed.renamed(["explain", "--steps", "4", "--steps=5"])[1:] == set_now
    assert set(renamed.OPTIONS) <= set(COMMANDS)
    assert CliRunner().invoke(app, ["submit", "absent", "--replace", "--check"]).exit_code == 2


def test_help_loads_no_library_that_takes_seconds(tmp_path: Path):
    code = (
        "import sys, racines_leaderboard.cli.command\n"
        "heavy = {'torch', 'datasets', 'polars', 'matplotlib', 'monai', 'torchrl', 'scipy'}\n"
        "heavy |= {'gradio'}\n"
        "assert not heavy & set(sys.modules), heavy & set(sys.modules)\n"
    )
    command(tmp_path, "python", "-c", code, fresh=True)


@pytest.mark.parametrize(
    ("given", "found"),
    [
        ({}, "1000"),  # before torch is loaded, which reads it once
        ({"GOMP_SPINCOUNT": "7"}, "7"),
        ({"OMP_WAIT_POLICY": "PASSIVE"}, None),
    ],
    ids=("by default", "the user's", "the user's policy"),
)
def test_waiting_threads_spin_briefly(monkeypatch, given: dict[str, str], found: str | None):
    for name in ("GOMP_SPINCOUNT", "OMP_WAIT_POLICY"):
        monkeypatch.setenv(name, "")  # so that what the command sets is taken back
        monkeypatch.delenv(name)
    for name, value in given.items():
        monkeypatch.setenv(name, value)
    seen: list[str | None] = []
    monkeypatch.setattr(
        "racines_leaderboard.cli.command.app",
        lambda: seen.append(os.environ.get("GOMP_SPINCOUNT")),
    )
    monkeypatch.setattr(sys, "path", list(sys.path))
    main()
    assert seen == [found]


def test_version(tmp_path: Path):
    assert command(tmp_path, "racines", "--version").stdout.startswith("racines 1.")


@pytest.mark.parametrize(
    "words",
    [("nonsense",), ("leaderboard", "--colour"), ("submit",), ("train", "nothing")],
    ids=" ".join,
)
def test_bad_usage_is_2(tmp_path: Path, words: tuple[str, ...]):
    done = command(tmp_path, "racines", *words, code=2)
    assert "Usage" in done.stderr


REFUSED = [
    (("leaderboard",), "no results of any board"),
    (("leaderboard", "--collect", "absent"), "--collect needs --board"),
    (("leaderboard", "--board", "b", "--collect", "absent"), "absent: no scores"),
    (("leaderboard", "--params", "absent.yaml"), "absent.yaml: no such file"),
    (("submit", "absent.yaml"), "absent.yaml: no such file"),
    (("expert", "sample", "--truth", "--out", "kit"), "no dataset"),
    (("expert", "rate", "absent", "--by", "simulated"), "absent/kit.json: no such file"),
    (("expert", "rate", "absent"), "absent/kit.json: no such file"),
    (("expert", "score", "absent", "anna.jsonl"), "absent/kit.json: no such file"),
    (("leaderboard", "--recompute", "nobody"), "params.yaml: no such file"),
    (("leaderboard", "--recompute", "nobody", "--params", "absent.yaml"), "absent.yaml"),
    (("data", "build", "--profile", "huge"), "unknown profile 'huge'"),
    (("data", "build", "--source", "nowhere"), "nowhere"),
    (("data", "validate", "absent"), "absent"),
    (("train", "grader", "--profile", "smoke"), "no dataset"),
    (("train", "generator", "vae-gna", "--profile", "smoke"), "vae-gna"),
    (("train", "generator", "mean-image", "--profile", "smoke"), "no dataset"),
    (("train", "agent", "nobody", "--profile", "smoke"), "nobody"),
    (("eval", "generator", "mean-image", "--profile", "smoke"), "no dataset"),
    (("eval", "agent", "ppo", "--profile", "smoke"), "racines train"),
]


@pytest.mark.parametrize(("words", "message"), REFUSED, ids=[" ".join(w) for w, _ in REFUSED])
def test_refused_input_is_1_with_one_line_of_reason(tmp_path, words, message):
    done = command(tmp_path, "racines", *words, code=1)
    assert message in done.stderr
    assert done.stderr.startswith("racines: ") and "Traceback" not in done.stderr
    assert not list(tmp_path.iterdir()), "a refused command leaves nothing behind"


def test_leaderboard_as_json_and_as_tables(tmp_path: Path):
    scores = tmp_path / "scores"
    scores.mkdir()
    (scores / "one.json").write_text(json.dumps(generator_scores("one")))
    words = ("racines", "leaderboard", "--board", "b", "--collect", "scores", "--json")
    document = json.loads(command(tmp_path, *words).stdout)
    assert [entry["name"] for entry in document["boards"]["b"]["generators"]] == ["one"]
    assert "reported in the paper, on other data" in command(tmp_path, *words[:2]).stdout
    command(tmp_path, "racines", "leaderboard", "--board", "c", code=1)


def test_params_name_the_board(tmp_path: Path):
    scores = tmp_path / "scores"
    scores.mkdir()
    (scores / "one.json").write_text(json.dumps(generator_scores("one")))
    (tmp_path / "params.yaml").write_text("board: mine\n")
    base = ("racines", "leaderboard", "--params", "params.yaml")
    command(tmp_path, *base, "--collect", "scores", "--markdown", "BOARD.md")
    assert (tmp_path / "leaderboard/results/mine/generators/one.json").exists()
    assert "## mine" in (tmp_path / "BOARD.md").read_text()
    assert "differs" in command(tmp_path, *base, "--board", "other", code=1).stderr


def test_submit(tmp_path: Path):
    path = write_submission(tmp_path / "in", track="agents")
    said = command(tmp_path, "racines", "submit", "in", code=1).stderr
    assert "mine: " in said and "VaeGan is not an agent" in said
    merged = {"kind": "adapter", "adapter": "racines_envs.agents.ppo:PPOAgent"}
    path = write_submission(tmp_path / "in", merged, track="agents")
    assert "sound" in command(tmp_path, "racines", "submit", "in").stdout
    stored = tmp_path / "leaderboard/submissions/agents/mine/submission.yaml"
    assert stored.exists()
    done = command(tmp_path, "racines", "submit", "in", "--force", "--json")
    assert json.loads(done.stdout)["name"] == "mine"
    path.write_text(path.read_text() + "extra: 1\n")
    words = ("racines", "submit", "in/submission.yaml", "--force")
    assert "'extra'" in command(tmp_path, *words, code=1).stderr
    assert "extra" not in stored.read_text()
