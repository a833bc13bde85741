"""The `racines` command as a shell sees it."""

import json
import time
from pathlib import Path

import pytest

from tests.conftest import command
from tests.leaderboard.conftest import generator_scores, write_submission

HELP = [
    (),
    ("data",),
    ("data", "build"),
    ("data", "validate"),
    ("data", "annotate"),
    ("study", "leakage"),
    ("study", "sheet"),
    ("train",),
    ("train", "grader"),
    ("train", "generator"),
    ("train", "agent"),
    ("eval",),
    ("eval", "generator"),
    ("eval", "agent"),
    ("explain",),
    ("drive",),
    ("replay",),
    ("leaderboard",),
    ("submit",),
    ("audit",),
    ("study", "determinism"),
    ("studio",),
    ("expert",),
    ("expert", "sample"),
    ("expert", "simulate"),
    ("expert", "oracle"),
    ("expert", "score"),
]


@pytest.mark.parametrize("words", HELP, ids=[" ".join(words) or "root" for words in HELP])
def test_help(tmp_path: Path, words: tuple[str, ...]):
    assert "Usage: racines" in command(tmp_path, "racines", *words, "--help").stdout


def test_help_loads_no_library_that_takes_seconds(tmp_path: Path):
    code = (
        "import sys, racines_leaderboard.cli.command\n"
        "heavy = {'torch', 'datasets', 'polars', 'matplotlib', 'monai', 'torchrl', 'scipy'}\n"
        "heavy |= {'gradio'}\n"
        "assert not heavy & set(sys.modules), heavy & set(sys.modules)\n"
    )
    start = time.monotonic()
    command(tmp_path, "python", "-c", code, fresh=True)
    assert time.monotonic() - start < 5, "generous: machines are noisy; the list is the test"


def test_version(tmp_path: Path):
    assert command(tmp_path, "racines", "--version").stdout.startswith("racines 0.")


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
    assert "sound" in command(tmp_path, "racines", "submit", "in").stdout
    stored = tmp_path / "leaderboard/submissions/agents/mine/submission.yaml"
    assert stored.exists()
    done = command(tmp_path, "racines", "submit", "in", "--force", "--json")
    assert json.loads(done.stdout)["name"] == "mine"
    path.write_text(path.read_text() + "extra: 1\n")
    words = ("racines", "submit", "in/submission.yaml", "--force")
    assert "'extra'" in command(tmp_path, *words, code=1).stderr
    assert "extra" not in stored.read_text()
