"""`racines demo`: what is drawn, shown, written and refused."""

import io
import json
import re
from dataclasses import replace
from pathlib import Path

import pytest
from PIL import Image, ImageColor, ImageSequence
from rich.console import Console
from typer.testing import CliRunner

from racines_data.errors import RacinesError
from racines_data.plotting import GREEN, PROBE, TRUTH, VIOLET
from racines_envs.demo import episode, film, run
from racines_envs.demo.chestmap import ChestMap
from racines_envs.demo.live import LiveView
from racines_envs.demo.page import page
from racines_leaderboard.cli.command import app
from tests.conftest import ROOT
from tests.documents import command_lines

STEPS = 3
SOUGHT = episode.Draw(20_035, 0)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[episode.Outcome, Path]:
    """A search cut off after few steps, and its folder."""
    patch = pytest.MonkeyPatch()
    patch.setattr(episode, "POLICY", ROOT / "envs/weights/servo")
    out = tmp_path_factory.mktemp("demo") / "demo"
    outcome = run.demonstrate(SOUGHT, episode.load_servo(), out, steps=STEPS)
    patch.undo()
    return outcome, out


@pytest.fixture(scope="module")
def chest(made: tuple[episode.Outcome, Path]) -> ChestMap:
    return ChestMap(made[0].heart, made[0].own)


def frames(moving: Image.Image) -> int:
    return sum(1 for _ in ImageSequence.Iterator(moving))


def content(text: str) -> dict:
    found = re.search(r'<script type="application/json" id="content">(.*?)</script>', text)
    assert found
    return json.loads(found[1])


def test_a_search_that_was_cut_off_is_told_as_not_found(made: tuple[episode.Outcome, Path]):
    outcome, out = made
    told = json.loads((out / "demo.json").read_text())
    assert told["schema"] == run.SCHEMA and told["steps"] == STEPS
    assert told["found"] is False and told["declared"] is False and told["true_grade"] == 0.0
    assert told["again"] == "racines demo --patient 20035 --seed 0"
    assert [shot.step for shot in outcome.shots] == [0, 1, 2, 3]
    shown = content((out / "index.html").read_text())
    assert shown["head"].startswith("Not found") and not shown["found"]
    assert "had not declared" in shown["text"]
    assert sorted(path.name for path in out.iterdir()) == ["demo.gif", "demo.json", "index.html"]


def test_the_page_holds_all_it_shows_and_says_what_it_is_not(made: tuple[episode.Outcome, Path]):
    text = (made[1] / "index.html").read_text()
    assert "Not a medical device" in text and "default-src 'none'" in text
    assert not re.search(r'(?:src|href)="|url\(|@import|https?://(?!www.w3.org/2000/svg")', text)
    shown = content(text)
    assert [each["step"] for each in shown["frames"]] == [0, 2, 3], "every other, and the last"
    pictures = [each[key] for each in shown["frames"] for key in ("seen", "map")]
    for each in (*pictures, shown["last"], shown["best"]):
        assert each.startswith("data:image/webp;base64,")


def test_the_film_is_of_every_third_step_and_the_end(made: tuple[episode.Outcome, Path]):
    with Image.open(made[1] / "demo.gif") as moving:
        assert moving.size == (film.WIDTH, film.HEIGHT) and frames(moving) == 3
        moving.seek(1)
        shown = moving.convert("RGB")
    colours = {colour for _, colour in shown.getcolors(1 << 20) or []}
    signs = {ImageColor.getrgb(each) for each in (PROBE, TRUTH, GREEN, VIOLET)}
    assert signs <= colours, "probe, truth and belief keep their colours"


def test_the_tracked_film_is_small_and_of_the_middle_of_the_found():
    path = ROOT / "docs/images/demo.gif"
    assert path.stat().st_size <= 1_500_000
    rows = json.loads((ROOT / "docs/results/films.json").read_text())["tables"]["episodes"]["rows"]
    patient, steps = next((row[1], int(row[2])) for row in rows if row[0] == "found-2")
    failing = next(row[1] for row in rows if row[0] == "failure")
    with Image.open(path) as moving:
        last = steps % film.EVERY > 0
        assert frames(moving) == steps // film.EVERY + 1 + last + 1
    for name in ("README.md", "docs/demo.md"):
        text = (ROOT / name).read_text()
        assert f"--patient {patient} --seed 0" in text and f"--patient {failing} --seed 0" in text


def test_each_way_to_end_has_its_words(made: tuple[episode.Outcome, Path]):
    outcome = made[0]
    last = outcome.shots[-1]._replace(grade=8.2, view=0)
    good = replace(outcome, shots=[last], found=True, declared=True)
    assert episode.verdict(good)[0] == "Found: the apical four-chamber view"
    assert "true grade 8.2" in episode.verdict(good)[1]
    poor = replace(good, found=False)
    assert "it is wrong" in episode.verdict(poor)[0]
    assert "right view but not good enough" in episode.verdict(poor)[1]
    for view, words in ((5, "no standard view"), (1, "the subcostal four-chamber view")):
        other = replace(poor, shots=[last._replace(view=view)])
        assert f"shows {words}" in episode.verdict(other)[1]


def test_nothing_ends_the_content_of_the_page(made: tuple[episode.Outcome, Path], chest: ChestMap):
    evil = "</script><img src=x>&<!--"
    text = page(made[0], chest, [(evil, "a $content")])
    assert evil not in text and content(text)["next"] == [{"command": evil, "about": "a $content"}]


def test_the_same_seed_draws_the_same(monkeypatch: pytest.MonkeyPatch):
    one = episode.drawn(None, 7, None, None)
    assert one == episode.drawn(None, 7, None, None) and one.patient in range(20_000, 20_140)
    assert one.again == f"racines demo --patient {one.patient} --seed 7"
    assert episode.drawn(one.patient, 7, None, None) == one, "what is printed repeats it"
    assert len({episode.drawn(None, seed, None, None).patient for seed in range(40)}) > 20
    monkeypatch.setattr(episode.secrets, "randbelow", lambda most: most - 1)
    assert episode.drawn(20_000, None, "SC", "patients").again == (
        "racines demo --patient 20000 --seed 999999 --view SC --tier patients"
    )


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ({"view": "A2C"}, "unknown view 'A2C'"),
        ({"tier": "heart"}, "choose patients or beating"),
        ({"patient": 1}, "1"),
        ({"patient": 15_000}, "no patient's"),
    ],
)
def test_what_cannot_be_scanned_is_refused(words: dict, told: str):
    settings = {"patient": None, "seed": 0, "view": None, "tier": None} | words
    with pytest.raises(RacinesError, match=told):
        episode.drawn(**settings)


def test_a_folder_of_another_kind_is_left_alone(tmp_path: Path, made: tuple[episode.Outcome, Path]):
    run.check_folder(tmp_path / "new", False)
    run.check_folder(tmp_path, False)
    run.check_folder(made[1], False)
    (tmp_path / "index.html").write_text("mine")
    with pytest.raises(RacinesError, match="no demonstration wrote.*--force"):
        run.check_folder(tmp_path, False)
    (tmp_path / "demo.json").write_text("[]")
    with pytest.raises(RacinesError, match="--force"):
        run.check_folder(tmp_path, False)
    run.check_folder(tmp_path, True)
    with pytest.raises(RacinesError, match="no folder"):
        run.check_folder(tmp_path / "index.html", True)


def test_it_runs_anywhere_and_without_weights_says_where_they_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.chdir(tmp_path)
    assert episode.load_servo().name == "servo"
    monkeypatch.setattr("racines_models.published.places.CHECKOUT", tmp_path)
    with pytest.raises(RacinesError, match="in a clone.*from its wheel"):
        episode.load_servo()
    assert not list(tmp_path.iterdir())


def test_live_shows_both_pictures_and_needs_a_terminal(
    made: tuple[episode.Outcome, Path], chest: ChestMap
):
    with pytest.raises(RacinesError, match="needs a terminal"):
        LiveView(Console(file=io.StringIO()))
    screen = io.StringIO()
    console = Console(file=screen, force_terminal=True, width=90, height=30, color_system="256")
    with LiveView(console) as live:
        live(chest, made[0].shots, SOUGHT)
    assert screen.getvalue().count("\u2580") > 500 and "it believes A4C" in screen.getvalue()


def test_the_commands_to_go_on_with_are_those_of_the_page():
    told = [command for command, _ in run.next_commands(SOUGHT)]
    written = (ROOT / "docs/demo.md").read_text()
    assert len(told) == 3 and all(f"    {command}\n" in written for command in told)
    assert set(told) <= {line.strip() for line in command_lines(written)}


@pytest.mark.thorough
def test_the_command_finds_the_view_and_repeats_the_tracked_film(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.chdir(ROOT)
    words = ["demo", "--patient", "20035", "--seed", "0", "--json", "--out", str(tmp_path / "demo")]
    done = CliRunner().invoke(app, words)
    told = json.loads(done.stdout)
    assert done.exit_code == 0 and told["found"] and told["true_view"] == "A4C"
    with (
        Image.open(tmp_path / "demo/demo.gif") as new,
        Image.open(ROOT / "docs/images/demo.gif") as old,
    ):
        assert frames(new) == frames(old)
