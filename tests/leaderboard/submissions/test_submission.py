"""The YAML of a submission and the names in it: what is refused before any file is looked into."""

import os
import pickle
import re
from pathlib import Path

import pytest

from racines_data.errors import RacinesError
from racines_leaderboard.submissions.document import KINDS, find_submission, read_submission
from racines_leaderboard.submissions.intake import look_at, take_in
from tests.conftest import ROOT
from tests.leaderboard.conftest import ADAPTER, DIGEST, artefact, write_submission

SAFETENSORS = (2).to_bytes(8, "little") + b"{}"


def weights(folder: Path, content: bytes = SAFETENSORS, **changes) -> Path:
    (folder / "w.safetensors").write_bytes(content)
    return write_submission(folder, artefact("weights", folder / "w.safetensors", **changes))


def test_a_sound_submission_with_weights(tmp_path):
    document = read_submission(weights(tmp_path))
    assert document["artefacts"][0]["size"] == len(SAFETENSORS)


@pytest.mark.parametrize("track", ["generators", "agents"])
def test_the_repositorys_own_submissions_are_sound(track):
    folder = ROOT / "leaderboard/submissions"
    names = sorted(path.name for path in (folder / track).iterdir())
    assert names and all(find_submission(folder, track, name) for name in names)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"score": 1}, "'score' was unexpected"),
        ({"licence": None}, "'licence' is a required"),
        ({"track": "both"}, "track: 'both'"),
        ({"authors": []}, "authors"),
        ({"authors": ["a" * 201]}, r"authors\.0"),
        ({"name": "My Model"}, "name"),
        ({"name": "../mine"}, "name"),
        ({"name": "mine\n"}, r"name: character U\+000A"),
        ({"method": "gr\x1b[31meen"}, r"method: character U\+001B|special characters"),
        ({"method": "evil \u202egnp.exe"}, r"method: character U\+202E"),
        ({"url": "file:///etc/passwd"}, "url"),
        ({"paper": "http://example.org"}, "paper"),
        ({"schema": "racines.submission/1"}, "give racines.submission/2"),
        ({"seeds": [True]}, r"seeds\.0"),
        ({"seeds": [2**80]}, r"seeds\.0: a number beyond 64 bits"),
        ({"training": {"budget": "b", "hardware": "h", "hours": float("nan")}}, "hours: nan"),
        ({"training": {"budget": "b", "hardware": "h", "hours": float("inf")}}, "hours: inf"),
        ({"training": {"budget": "b", "hardware": "h", "gpu": 1}}, "'gpu' was unexpected"),
        ({"code": {"commit": "abcdef0"}}, "code: 'url' is a dependency"),
        ({"dataset": {"source": "phantom", "version": "1"}}, r"dataset\.version"),
        ({"artefacts": []}, "artefacts"),
        ({"artefacts": [dict(ADAPTER) for _ in range(11)]}, "artefacts"),
        (
            {"artefacts": [{"kind": "x", "path": "w.bin", "sha256": "0" * 64, "size": 1}]},
            r"artefacts\.0\.kind",
        ),
        ({"artefacts": [{"kind": "weights", "path": "w.safetensors"}]}, "'sha256' is a required"),
    ],
)
def test_unknown_missing_and_unbounded_fields_fail(tmp_path, changes, message):
    with pytest.raises(RacinesError, match=message):
        read_submission(write_submission(tmp_path, **changes))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a: [", "not readable as YAML"),
        ("- a", "object"),
        ("a: &x [1]\nb: *x", "aliases"),
        ("a: 1\na: 2", "stands twice"),
        ("[" * 500 + "]" * 500, "nested more than 12 deep"),
        ("a: !!python/object/apply:os.system ['touch owned']", "not readable as YAML"),
        ("\xff\xfe", "schema|YAML|object"),
        ("x" * 70_000, "70,000 bytes: give a file of 1 to 65,536"),
    ],
    ids=range(8),
)
def test_yaml_is_data_and_bounded(tmp_path, monkeypatch, text, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "submission.yaml").write_text(text)
    with pytest.raises(RacinesError, match=message):
        read_submission(tmp_path / "submission.yaml")
    assert not (tmp_path / "owned").exists()


@pytest.mark.parametrize(
    "name",
    [
        "../w.safetensors", "/etc/w.safetensors", "a/w.safetensors", "..\\w.safetensors",
        "C:w.safetensors", ".w.safetensors", "nul.safetensors", "w\x00.safetensors",
        "w.safetensors\n", "~.safetensors", "w .safetensors", "ẁ.safetensors", "",
    ],
)  # fmt: skip
def test_names_that_are_no_bare_file_name(tmp_path, name):
    (tmp_path / "in").mkdir()
    (tmp_path / "w.safetensors").write_bytes(SAFETENSORS)
    entry = artefact("weights", tmp_path / "w.safetensors", path=name)
    with pytest.raises(RacinesError, match="refused|special characters"):
        read_submission(write_submission(tmp_path / "in", entry))


@pytest.mark.parametrize("kind", sorted(set(KINDS) - {"adapter"}))
def test_a_kind_has_its_ending_and_its_track(tmp_path, kind):
    tracks = KINDS[kind].tracks
    (tmp_path / "model.pt").write_bytes(SAFETENSORS)
    entry = artefact(kind, tmp_path / "model.pt")
    with pytest.raises(RacinesError, match=f"'model.pt' refused: {kind} is a"):
        read_submission(write_submission(tmp_path, entry, track=tracks[0]))
    for track in {"generators", "agents"} - set(tracks):
        with pytest.raises(RacinesError, match=f"{kind} is none of {track}"):
            read_submission(write_submission(tmp_path, entry, track=track))


def test_a_file_stands_once(tmp_path):
    weights(tmp_path)
    entry = artefact("weights", tmp_path / "w.safetensors")
    other = entry | {"path": "W.safetensors"}
    with pytest.raises(RacinesError, match="stands twice"):
        read_submission(write_submission(tmp_path, entry, other))


class Payload:
    """Code that a pickle runs when it is loaded."""

    def __init__(self, path: Path):
        self.path = str(path)

    def __reduce__(self):
        return os.mkdir, (self.path,)


@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
def test_pickles_under_another_name_are_refused_and_never_loaded(tmp_path, protocol):
    content = pickle.dumps(Payload(tmp_path / "owned"), protocol)
    with pytest.raises(RacinesError, match="holds a pickle"):
        read_submission(weights(tmp_path, content))
    assert not (tmp_path / "owned").exists()
    pickle.loads(content)
    assert (tmp_path / "owned").exists(), "the payload is a true one"


@pytest.mark.parametrize("spoil", ["symlink", "folder", "fifo", "empty", "device"])
def test_what_is_no_plain_file_is_refused(tmp_path, spoil):
    path = weights(tmp_path)
    file = tmp_path / "w.safetensors"
    file.unlink()
    if spoil == "symlink":
        (tmp_path / "secret").write_bytes(SAFETENSORS)
        file.symlink_to(tmp_path / "secret")
    elif spoil == "device":
        file.symlink_to("/dev/zero")
    elif spoil == "folder":
        file.mkdir()
    elif spoil == "fifo":
        os.mkfifo(file)
    else:
        file.touch()
    with pytest.raises(RacinesError, match="symbolic link|no regular file|0 bytes"):
        read_submission(path)


def test_size_and_digest_are_those_claimed(tmp_path):
    for changes in ({"sha256": DIGEST}, {"size": 11}):
        with pytest.raises(RacinesError, match="the file has sha256 .* and 10 bytes"):
            read_submission(weights(tmp_path, **changes))
    with pytest.raises(RacinesError, match=r"size: 10000000000 is greater"):
        read_submission(weights(tmp_path, size=10_000_000_000))
    path = weights(tmp_path)
    (tmp_path / "w.safetensors").unlink()
    with pytest.raises(RacinesError, match="no such file"):
        read_submission(path)


def test_ten_gigabytes_are_not_read(tmp_path):
    path = weights(tmp_path)
    with (tmp_path / "w.safetensors").open("r+b") as file:
        file.truncate(10 * 2**30)
    with pytest.raises(RacinesError, match="10,737,418,240 bytes: give a file of 1 to"):
        read_submission(path)


@pytest.mark.parametrize(
    ("target", "message"),
    [
        ("os:system", "only merged code"),
        ("stranger.model:Model", "only merged code"),
        ("submission:Model", "only merged code"),
        ("racines_models.generators.absent:Model", "no such module"),
        ("racines_models", "adapter"),
        ("racines_models..x:y", "adapter"),
    ],
)
def test_adapters_are_merged_code(tmp_path, target, message):
    (tmp_path / "submission.py").write_text(f"open({str(tmp_path / 'owned')!r}, 'w')")
    path = write_submission(tmp_path, ADAPTER | {"adapter": target})
    with pytest.raises(RacinesError, match=message):
        read_submission(path)
    assert not (tmp_path / "owned").exists()


def test_errors_name_the_file_that_was_handed_in(tmp_path):
    folder = tmp_path / "in"
    folder.mkdir()
    (folder / "policy.onnx").write_bytes(b"\x08\x01 no graph")
    dataset = {"source": "phantom", "version": "1.0.0", "digest": "3" * 63 + "a"}
    write_submission(
        folder, artefact("policy", folder / "policy.onnx"), track="agents", dataset=dataset
    )
    for look in (look_at, take_in):
        with pytest.raises(RacinesError, match=re.escape(f"{folder}/policy.onnx: ")):
            look(folder, tmp_path / "submissions")


def test_a_trace_has_no_robustness(tmp_path):
    kinds = {"trace": "t.json", "robustness": "r.json"}
    for i, name in enumerate(kinds.values()):
        (tmp_path / name).write_text(f"{{}} {i}")
    entries = [artefact(kind, tmp_path / name) for kind, name in kinds.items()]
    dataset = {"source": "phantom", "version": "1.0.0", "digest": "3" * 63 + "a"}
    path = write_submission(tmp_path, *entries, track="patient-agents", dataset=dataset)
    with pytest.raises(RacinesError, match="a trace looks at nothing: leave robustness out"):
        read_submission(path)
