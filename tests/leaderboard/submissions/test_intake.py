"""`racines submit`: all or nothing, never outside its folder, never in a stranger's hands."""

import gzip
import http.server
import io
import json
import os
import pickle
import tarfile
import threading
import urllib.request
import zipfile
from pathlib import Path

import pytest
import yaml
from typer.testing import CliRunner

from racines_data.errors import RacinesError
from racines_envs.worlds.making import patients_recipe
from racines_leaderboard.cli.command import app
from racines_leaderboard.submissions.document import BLANKS, find_submission
from racines_leaderboard.submissions.intake import open_https, take_in
from racines_leaderboard.submissions.template import write_template
from racines_leaderboard.submissions.worlds import made_for
from tests.leaderboard.conftest import DIGEST, artefact, generator_scores, write_submission
from tests.leaderboard.graphs import sound_generator, sound_policy
from tests.leaderboard.handed_in import inbox as place
from tests.leaderboard.submissions.test_submission import Payload
from tests.waiting import PATIENCE


def tree(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*")}


@pytest.fixture
def inbox(tmp_path):
    """A folder with a generator, and the submission of it."""
    folder = tmp_path / "inbox"
    folder.mkdir()
    sound_generator(folder / "mine.onnx")
    write_submission(folder, artefact("generator", folder / "mine.onnx"), tier="recomputed")
    return folder


def refused(inbox: Path, message: str, **how) -> None:
    """Check that a submission is refused, and that nothing is written or run."""
    root = inbox.parent
    before = tree(root)
    with pytest.raises(RacinesError, match=message):
        take_in(inbox, root / "new" / "submissions", **how)
    assert tree(root) == before
    assert not (root / "owned").exists()


def test_a_submission_is_copied_whole_and_reread(inbox, tmp_path):
    (inbox / "notes.txt").write_text("not named, not copied")
    taken = take_in(inbox / "submission.yaml", tmp_path / "out")
    assert taken.folder == tmp_path / "out/generators/mine" and taken.remote == ()
    assert {path.name for path in taken.folder.iterdir()} == {"mine.onnx", "submission.yaml"}
    assert (taken.folder / "mine.onnx").read_bytes() == (inbox / "mine.onnx").read_bytes()
    assert find_submission(tmp_path / "out", "generators", "mine") == taken.document
    assert not list((tmp_path / "out").rglob(".*")), "no temporary folder stays"


def test_a_check_copies_nothing_and_finds_what_taking_in_would(inbox, tmp_path):
    before = tree(tmp_path)
    words = ["submit", str(inbox), "--check", "--out", str(tmp_path / "out")]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0 and "sound (mine, generators)" in done.stdout
    assert tree(tmp_path) == before
    (inbox / "mine.onnx").write_bytes(pickle.dumps([1]))
    assert isinstance(CliRunner().invoke(app, words).exception, RacinesError)
    assert CliRunner().invoke(app, [*words, "--force"]).exit_code == 2
    assert tree(tmp_path) == before


def _zip(payload: bytes) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("archive/data.pkl", payload)
        archive.writestr("archive/data/0", bytes(2**26))
    return buffer.getvalue()


def _tar(payload: bytes) -> bytes:
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w") as archive:
        member = tarfile.TarInfo("../../owned")
        member.size = len(payload)
        archive.addfile(member, io.BytesIO(payload))
    return buffer.getvalue()


NAMES = {
    "predictions": "p.parquet",
    "generator": "g.onnx",
    "weights": "w.safetensors",
    "scores": "s.json",
}
DISGUISES = ("pickle", "old pickle", "zip bomb", "tar", "gzip", "script")


@pytest.mark.parametrize(
    ("kind", "name", "disguise"),
    [
        # Each disguise under one name here, each name under some; all in `make test-thorough`.
        pytest.param(kind, name, told, marks=[] if (i - j) % 4 == 0 else [pytest.mark.thorough])
        for i, (kind, name) in enumerate(NAMES.items())
        for j, told in enumerate(DISGUISES)
    ],
)
def test_what_runs_or_unpacks_is_refused_under_every_name(tmp_path, kind, name, disguise):
    folder = tmp_path / "inbox"
    folder.mkdir()
    payload = pickle.dumps(Payload(tmp_path / "owned"), 0 if disguise == "old pickle" else 4)
    content = {
        "zip bomb": _zip(payload),
        "tar": _tar(payload),
        "gzip": gzip.compress(bytes(2**26)),
        "script": f"#!/bin/sh\ntouch {tmp_path / 'owned'}\n".encode(),
    }.get(disguise, payload)
    (folder / name).write_bytes(content)
    write_submission(folder, artefact(kind, folder / name))
    refused(folder, f"{name} holds a")


@pytest.mark.parametrize("name", ["../mine.onnx", "/mine.onnx", "..\\mine.onnx", "a/../b.onnx"])
def test_paths_do_not_escape(inbox, name):
    entry = artefact("generator", inbox / "mine.onnx", path=name)
    write_submission(inbox, entry)
    (inbox.parent / "mine.onnx").write_bytes((inbox / "mine.onnx").read_bytes())
    refused(inbox, "refused: give the bare name")


def test_links_are_not_followed(inbox, tmp_path):
    secret = (inbox / "mine.onnx").rename(tmp_path / "secret.onnx")
    (inbox / "mine.onnx").symlink_to(secret)
    refused(inbox, "mine.onnx: a symbolic link")
    (inbox / "mine.onnx").unlink()
    secret.rename(inbox / "mine.onnx")
    (inbox / "submission.yaml").rename(tmp_path / "real.yaml")
    (inbox / "submission.yaml").symlink_to(tmp_path / "real.yaml")
    refused(inbox, "submission.yaml: a symbolic link")


def test_nothing_is_written_through_a_link(inbox, tmp_path):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "generators").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(RacinesError, match="nothing is written through it"):
        take_in(inbox, tmp_path / "out")
    assert not list((tmp_path / "elsewhere").iterdir())


def test_a_ten_gigabyte_claim_is_refused(inbox):
    write_submission(inbox, artefact("generator", inbox / "mine.onnx", size=10 * 2**30))
    refused(inbox, "size: 10737418240 is greater than")
    with (inbox / "mine.onnx").open("r+b") as file:
        file.truncate(10 * 2**30)
    write_submission(inbox, artefact("generator", inbox / "x", path="mine.onnx"))
    refused(inbox, "10,737,418,240 bytes: give a file of 1 to")


def test_scores_that_are_not_finite_are_refused(inbox):
    text = json.dumps(generator_scores("mine")).replace("20.0", "NaN")
    (inbox / "scores.json").write_text(text)
    write_submission(inbox, artefact("scores", inbox / "scores.json"))
    refused(inbox, "scores.json: holds NaN")


def test_a_name_is_taken_once_and_replaced_by_its_author(inbox, tmp_path):
    out = tmp_path / "out"
    take_in(inbox, out)
    first = tree(out)
    with pytest.raises(RacinesError, match="name: 'mine' is taken"):
        take_in(inbox, out)
    entry = artefact("generator", inbox / "mine.onnx")
    write_submission(inbox, entry, authors=["Somebody Else"])
    with pytest.raises(RacinesError, match="authors: .* is by Somebody: only one of them"):
        take_in(inbox, out, replace=True)
    write_submission(inbox, entry, authors=["Somebody", "Another"], method="renewed")
    taken = take_in(inbox, out, replace=True)
    assert tree(out) == first and taken.document["method"] == "renewed"
    stored = yaml.safe_load((taken.folder / "submission.yaml").read_text())
    assert stored["authors"] == ["Somebody", "Another"]


def test_it_is_plain_what_is_scored(inbox):
    sound_generator(inbox / "more.onnx", speckle=0.03)
    one, other = (artefact("generator", inbox / name) for name in ("mine.onnx", "more.onnx"))
    drawn = artefact("predictions", inbox / "p.parquet")
    write_submission(inbox, one, drawn)
    refused(inbox, "give one that is scored again")
    write_submission(inbox, artefact("weights", inbox / "w.safetensors"), tier="recomputed")
    refused(inbox, "tier: recomputed needs predictions")
    write_submission(inbox, one, tier="reproduced")
    refused(inbox, "tier: reproduced needs merged code")
    write_submission(inbox, one, other, tier="recomputed")
    assert len(take_in(inbox, inbox.parent / "out").document["artefacts"]) == 2


class Server:
    """Serves a folder on this machine, and counts what it was asked."""

    def __init__(self, folder: Path) -> None:
        asked = self.asked = []

        class Handler(http.server.SimpleHTTPRequestHandler):
            def __init__(self, *words, **options):
                super().__init__(*words, directory=str(folder), **options)

            def do_GET(self):
                asked.append(self.path)
                super().do_GET()

            def log_message(self, format, *args):
                pass

        self._server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        threading.Thread(target=self._server.serve_forever, args=(0.02,), daemon=True).start()

    def open(self, url: str):
        port = self._server.server_address[1]
        there = url.replace("https://example.org", f"http://127.0.0.1:{port}")
        proxied = urllib.request.build_opener(urllib.request.ProxyHandler({}))
        return proxied.open(there, timeout=PATIENCE)

    def close(self) -> None:
        self._server.shutdown()
        self._server.server_close()


@pytest.fixture
def remote(inbox, tmp_path):
    """The generator lies at a URL alone."""
    (tmp_path / "www").mkdir()
    entry = artefact("generator", inbox / "mine.onnx", url="https://example.org/mine.onnx")
    (inbox / "mine.onnx").rename(tmp_path / "www" / "mine.onnx")
    write_submission(inbox, entry)
    server = Server(tmp_path / "www")
    yield server
    server.close()


def test_a_url_is_fetched_only_when_asked(inbox, remote, tmp_path):
    left = take_in(inbox, tmp_path / "left", opener=remote.open)
    assert left.remote == ("mine.onnx",) and not remote.asked
    assert find_submission(tmp_path / "left", "generators", "mine") == left.document
    taken = take_in(inbox, tmp_path / "out", fetching=True, opener=remote.open)
    assert taken.remote == () and remote.asked == ["/mine.onnx"]
    served = (tmp_path / "www/mine.onnx").read_bytes()
    assert (taken.folder / "mine.onnx").read_bytes() == served


@pytest.mark.parametrize(
    ("served", "message"),
    [
        (lambda content: content + b"x", "more than the [0-9,]+ bytes of its entry"),
        (lambda content: content[:-1], "the file has sha256"),
        (lambda content: content[:-1] + b"x", "the file has sha256"),
        (lambda content: pickle.dumps(content)[: len(content)], "holds a pickle"),
        (None, "cannot be fetched: HTTP Error 404"),
    ],
)
def test_what_comes_is_what_was_claimed(inbox, remote, tmp_path, served, message):
    path = tmp_path / "www/mine.onnx"
    content = path.read_bytes()
    path.unlink() if served is None else path.write_bytes(served(content))
    refused(inbox, message, fetching=True, opener=remote.open)


def test_only_https_is_opened(tmp_path):
    (tmp_path / "secret").write_text("x")
    for url in (f"file://{tmp_path / 'secret'}", "http://127.0.0.1:9/x", "data:,x"):
        with pytest.raises(OSError, match="unknown url type"):
            open_https(url)


def invoke(*words: str, code: int = 0) -> str:
    done = CliRunner().invoke(app, [str(word) for word in words])
    assert done.exit_code == code, done.output
    return done.output


def test_the_command_says_what_is_scored_again(inbox, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    said = invoke("submit", inbox)
    assert "leaderboard/submissions/generators/mine: sound" in said
    assert "Scored again: mine.onnx (a network that draws)" in said
    assert "racines leaderboard --recompute generators/mine" in said
    document = json.loads(invoke("submit", inbox, "--force", "--json"))
    assert document["rescored"] == ["mine.onnx"] and document["name"] == "mine"


def test_a_template_names_what_the_files_were_made_for(tmp_path):
    world = patients_recipe("beating")
    sound_policy(place(tmp_path, "policy") / "p.onnx", view="SC-beating")
    path = write_template(tmp_path / "policy", "patient-agents")
    told = yaml.safe_load(path.read_text())["dataset"]
    assert told == {
        "source": "phantom", "version": world["version"], "digest": world["recipe_digest"],
    }  # fmt: skip
    # What a file says is taken as it may stand, and left blank else.
    for phantom in ({"version": "1: x", "recipe_digest": "y"}, {}, {"version": ["a"]}):
        assert made_for_of(tmp_path, phantom) == {}
    assert made_for_of(tmp_path, {"version": "2.0.1", "recipe_digest": DIGEST}) == {
        "version": "2.0.1", "digest": DIGEST,
    }  # fmt: skip
    sound_policy(place(tmp_path, "heart") / "p.onnx", view="SC")
    path = write_template(tmp_path / "heart", "patient-agents")
    assert yaml.safe_load(path.read_text())["dataset"]["digest"] == "0" * 64


def made_for_of(folder, phantom):
    told = {
        "schema": "racines.trace/1", "agent": "a", "observation": "params", "backend": "phantom",
        "reward": "oracle", "task": {"view": "SC"}, "phantom": phantom,
        "start_set": {"seeds": [0], "starts": 1},
        "episodes": [{"set": 0, "index": 0, "actions": [12]}],
    }  # fmt: skip
    (folder / "t.json").write_text(json.dumps(told))
    return made_for(folder / "t.json", "trace", "agents")


def test_a_template_fits_once_it_is_filled_in(tmp_path):
    folder = tmp_path / "my-model"
    folder.mkdir()
    sound_generator(folder / "mine.onnx")
    (folder / "notes.txt").write_text("left alone")
    assert "submission.yaml" in invoke("submit", "--new", folder)
    path = folder / "submission.yaml"
    with pytest.raises(RacinesError, match="fill them in") as refused:
        take_in(folder, tmp_path / "out")
    assert all(repr(blank) in str(refused.value) for blank in BLANKS)  # at once
    text = path.read_text().replace("0" * 64, DIGEST).replace('"0000000"', '"0a1b2c3"')
    for blank in BLANKS:
        text = text.replace(blank, "filled in")
    path.write_text(text)
    taken = take_in(folder, tmp_path / "out")
    assert taken.document["name"] == "my-model"
    assert [each["path"] for each in taken.document["artefacts"]] == ["mine.onnx"]
    before = path.read_bytes()
    done = CliRunner().invoke(app, ["submit", "--new", str(folder)])
    assert isinstance(done.exception, RacinesError) and path.read_bytes() == before


def test_a_refusal_is_killed_half_way_and_leaves_nothing(inbox, tmp_path, monkeypatch):
    """The rename is the last step: what stops before it leaves no folder."""
    monkeypatch.setattr(os, "rename", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
    with pytest.raises(KeyboardInterrupt):
        take_in(inbox, tmp_path / "out")
    assert not (tmp_path / "out").exists()
