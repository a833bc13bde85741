"""The app as a server: what it offers, what it refuses, many visitors at once."""

from collections import Counter
from pathlib import Path

import pytest

from racines_data.errors import RacinesError
from racines_leaderboard.studio.parts import Place
from tests.conftest import ROOT, command
from tests.documents import blocks

gradio = pytest.importorskip("gradio", reason='needs Gradio: pip install "racines[studio]"')
httpx = pytest.importorskip("httpx", reason="comes with Gradio")
from tests.leaderboard.studio.load import Visitor, run  # noqa: E402

HEADS = {"files": ("a.py", b"print(1)")}


def test_uploads_are_refused_and_files_not_served(served: str, place: Place):
    for address in ("/gradio_api/upload", "/upload", "/gradio_api/upload?upload_id=x"):
        assert httpx.post(served + address, files=HEADS).status_code in (403, 404, 405)
    key = place.kits / "kit" / "key.json" if place.kits else Path()
    assert key.is_file()
    for path in (key, "pyproject.toml", "/etc/passwd", place.results / "tiny"):
        found = httpx.get(f"{served}/gradio_api/file={path}")
        assert found.status_code in (403, 404), path


def test_no_part_of_the_page_takes_a_file(served: str):
    config = httpx.get(f"{served}/config").json()
    kinds = {part["type"] for part in config["components"]}
    takers = {"file", "uploadbutton", "image", "imageeditor", "audio", "video", "multimodaltextbox"}
    assert not kinds & (takers | {"model3d", "chatbot", "fileexplorer", "code"})
    boxes = [part["props"] for part in config["components"] if part["type"] == "textbox"]
    assert boxes and all(box["max_length"] <= 200 for box in boxes)
    assert not config.get("share_url") and config["analytics_enabled"] is False


@pytest.mark.thorough
def test_many_visitors_at_once(served: str):
    """Each does one of six things, however long it takes: so each thing is done by two."""
    told = run(served, sessions=12, turns=1)
    assert not told.errors
    calls: Counter[str] = Counter()
    for name, each in told.seconds.items():
        calls["probe_step" if name.startswith("probe_step") else name] += len(each)
    assert calls == {
        "boards_show": 2, "data_show": 2, "data_move": 4, "study_begin": 2, "study_save": 6,
        "study_leave": 2, "probe_start": 2, "probe_step": 6, "generators_set": 2,
        "generators_draw": 2, "agent_watch": 2, "agent_show": 4,
    }  # fmt: skip


FORGED = {
    "boards_show": ["<script>", "generators", "all", "all", [], False],
    "boards_record": ["../mine", "tiny", "generators", "all", "all", [], False],
    "data_move": ["frames", "../../etc", 1],
    "data_listed": ["frames", "all", "all"],
    "study_begin": ["../kit", "anna", "I try the page out", "", ""],
}


@pytest.mark.parametrize("event", FORGED)
def test_a_forged_value_is_refused(served: str, event: str):
    with pytest.raises(RuntimeError, match="not in the list of choices|was not offered"):
        Visitor(served, seed=99).call(event, *FORGED[event])


def test_a_state_that_the_browser_makes_up_is_not_read(served: str):
    forged = {"rater": "anna", "image": "0001", "kit": "kit", "ratings": "/tmp"}
    answer = Visitor(served, seed=98).call("study_save", forged, None, None)
    assert "answered" not in str(answer)


def test_a_place_without_anything_says_what_to_run(tmp_path: Path):
    from racines_leaderboard.studio.app import TABS, build

    absent = tmp_path / "<b>absent"
    app = build(Place(absent, absent, absent, absent, absent, absent, absent))
    told = [str(b.value) for b in app.blocks.values() if isinstance(b, gradio.HTML)]
    page = "".join(told)
    assert "racines data build" in page and "racines expert sample" in page
    assert "racines leaderboard" in page and "<b>absent" not in page
    with pytest.raises(RacinesError, match="--tab nothing: choose among leaderboards"):
        build(Place(), ["nothing"])
    assert set(TABS) >= {"leaderboards", "study", "dataset"}


def test_one_tab_can_be_shown_alone(place: Place):
    from racines_leaderboard.studio.app import build

    app = build(place, ["study"])
    tabs = [block.label for block in app.blocks.values() if isinstance(block, gradio.Tab)]
    assert tabs == ["Expert study"]


def test_a_space_is_three_lines(tmp_path: Path, place: Place, monkeypatch: pytest.MonkeyPatch):
    from racines_leaderboard.studio import app

    (code,) = [b.text for b in blocks(ROOT / "docs/studio.md") if "serve(" in b.text]
    assert len(code.strip().splitlines()) == 4
    launched = {}
    monkeypatch.setattr(gradio.Blocks, "launch", lambda self, **given: launched.update(given))
    monkeypatch.chdir(tmp_path)
    exec(compile(code, "app.py", "exec"), {"__name__": "__main__"})
    assert launched["server_name"] == "0.0.0.0" and launched["share"] is False
    assert app.serve.__defaults__ and app.serve.__defaults__[1] == "127.0.0.1"


def test_a_port_that_is_taken_is_named(served: str, place: Place):
    from racines_leaderboard.studio.app import serve

    port = int(served.rsplit(":", 1)[1])
    with pytest.raises(RacinesError, match=f"--port {port}"):
        serve(place, port=port, block=False)


def test_the_command_refuses_what_it_cannot_do(tmp_path: Path):
    refused = command(tmp_path, "racines", "studio", "--tab", "nothing", code=1)
    assert "--tab nothing" in refused.stderr
    assert "--share" not in command(tmp_path, "racines", "studio", "--help").stdout
    command(tmp_path, "racines", "studio", "--port", "0", code=2)
