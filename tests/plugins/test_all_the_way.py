"""One plug-in of each kind, of an installed package, followed to where a user meets it.

The package lies outside the repository and is found by its metadata alone. One process walks all of
it (`theirs/walk.py`): what it saw is looked at here, where the package is not installed.
"""

import json
import os
import shutil
from pathlib import Path
from typing import Any

import pytest
import yaml

import racines_data
from racines_data.manifest import describe, read_manifest
from tests.conftest import ROOT, Once, command
from tests.plugins.packages import install

POINTS = {
    "racines.sources": {"mine": "their_source:Mine"},
    "racines.generators": {"flat": "their_generator:Flat"},
    "racines.agents": {"still": "their_agent:Still"},
    "racines.rewards": {"mine": "their_reward:MINE"},
    "racines.metrics": {"offset": "their_metrics:OFFSET", "shift": "their_metrics:SHIFT"},
    "racines.columns": {"seeds": "their_metrics:SEEDS"},
    "racines.anatomies": {"cyst": "their_organ:cyst [CY]"},
    "racines.judges": {"tiny": "their_rest:Tiny"},
    "racines.exporters": {"names": "their_rest:export"},
    "racines.commands": {"greet": "their_rest:greet", "broken": "nowhere:at_all"},
}
PARAMS = {
    "board": "theirs",
    "data": {"workers": 1, "mine": {"trajectories": 18}},
    "scores": {"samples": 16, "resamples": 20, "blocks": 3, "speed": False},
}

pytestmark = pytest.mark.docs


@pytest.fixture(scope="module")
def walked(made_once: Once) -> tuple[Path, dict[str, Any]]:
    """The folder in which a user with that package worked, and what there was to see."""
    work = made_once("all-the-way", walk) / "work"
    return work, json.loads((work / "seen.json").read_text())


def walk(folder: Path) -> None:
    site, work = folder / "site", folder / "work"
    site.mkdir()
    work.mkdir()
    for file in sorted((Path(__file__).parent / "theirs").glob("their_*.py")):
        shutil.copy(file, site)
    install(site, "their_package", POINTS)
    shutil.copy(Path(__file__).parent / "theirs" / "walk.py", work)
    (work / "params.yaml").write_text(yaml.safe_dump(PARAMS))
    places = [str(site), *(str(ROOT / part) for part in (".", "models", "envs", "leaderboard"))]
    with pytest.MonkeyPatch.context() as patch:
        before = os.environ.get("PYTHONPATH")
        patch.setenv("PYTHONPATH", os.pathsep.join([*places, *([before] if before else [])]))
        patch.setenv("SEEN", str(work / "seen.json"))
        words = "import runpy; from tests import warm; warm.plain_pictures()\n"
        words += "runpy.run_path('walk.py', run_name='__main__')"
        command(work, "python", "-c", words, fresh=True)


def test_a_source_is_built_loaded_checked_and_exported(walked):
    seen = walked[1]
    assert seen["built"] == ["mine", "0.3.0", 144]
    assert seen["valid"] is True and seen["loaded"] == "mine"
    assert seen["exported"] is True


def test_its_data_are_read_where_it_is_not_installed(walked):
    root = walked[0] / "racines"
    assert "mine (gray squares of a test); version 0.3.0" in describe(read_manifest(root))
    card = (root / "README.md").read_text()
    for said in ("license: mit", "Painted by a test.", "Of no use.", "— gray squares of a test.**"):
        assert said in card
    assert racines_data.open_store(root).manifest["source"] == "mine"


def test_a_reward_an_agent_and_an_organ_in_an_environment(walked):
    seen = walked[1]
    assert seen["reward"] == ["mine", True]
    assert seen["agent"] == 200  # it never moves, and the task has so many steps
    assert seen["organ"] == ["cyst", "CY"]


def test_metrics_and_a_column_on_the_board(walked):
    scores, board = walked[1]["scores"], walked[1]["board"]
    for name, unit in (("offset", "gray"), ("shift", None)):
        metric = scores[name]
        assert metric["low"] <= metric["value"] <= metric["high"] and metric["n"] == 16
        assert metric.get("unit") == unit
    assert scores["offset"]["settings"]["rule"] == "mean gray"
    for head in ("Gray offset (gray) ↓", "Feature shift ↓", "Seeds drawn", "SSIM ↑"):
        assert head in board, board
    assert "flat" in board and "Data: mine 0.3.0" in board


def test_a_command_and_a_judge(walked):
    seen = walked[1]
    assert seen["command"] == "hello you!\n"
    assert "greet" in seen["help"] and "broken" in seen["help"]
    assert seen["judge"] == "Tiny"
