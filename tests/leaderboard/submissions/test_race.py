"""Processes that take in or collect at the same time, and what may not pass for something else."""

import hashlib
import json
import multiprocessing
from functools import partial
from pathlib import Path

import pytest

from racines_data.errors import RacinesError
from racines_data.files import locked
from racines_leaderboard.board import collect as boards
from racines_leaderboard.records.names import made_up, skeleton
from racines_leaderboard.submissions import intake
from racines_leaderboard.submissions.document import BLANKS, read_document
from racines_leaderboard.submissions.probe import Probed
from racines_leaderboard.submissions.template import TEXT
from tests.conftest import ROOT
from tests.leaderboard.conftest import DIGEST, artefact, generator_scores, write_submission
from tests.waiting import PATIENCE

FORK = multiprocessing.get_context("fork")
SAFETENSORS = (2).to_bytes(8, "little") + b"{}"


def handed_in(folder: Path, content: bytes = SAFETENSORS, **changes) -> Path:
    folder.mkdir()
    (folder / "w.safetensors").write_bytes(content)
    write_submission(folder, artefact("weights", folder / "w.safetensors"), **changes)
    return folder


def tensors(count: int) -> bytes:
    """Return a sound safetensors file of as many bytes of data, another for each count."""
    head = json.dumps({"w": {"dtype": "U8", "shape": [count], "data_offsets": [0, count]}})
    return len(head).to_bytes(8, "little") + head.encode() + bytes(count)


def at_once(*jobs) -> list[str]:
    """Run jobs in processes of their own; return what each said, sorted."""
    told = FORK.SimpleQueue()

    def run(job) -> None:
        try:
            job()
            told.put("done")
        except RacinesError as error:
            told.put(str(error))
        except BaseException as error:
            told.put(f"traceback: {type(error).__name__}: {error}")

    processes = [FORK.Process(target=run, args=(job,)) for job in jobs]
    for process in processes:
        process.start()
    for process in processes:
        process.join(PATIENCE)
        assert process.exitcode == 0
    return sorted((told.get() for _ in jobs), key=lambda said: said != "done")


def test_one_process_at_a_time_holds_a_folder(tmp_path):
    """A lock that is removed as it is let go of still keeps everybody else out."""
    count = tmp_path / "count"
    count.write_text("0")

    def add() -> None:
        for _ in range(25):
            with locked(tmp_path / "held", PATIENCE):
                count.write_text(str(int(count.read_text()) + 1))

    assert at_once(*[add] * 4) == ["done"] * 4
    assert count.read_text() == "100" and not list((tmp_path / "held").iterdir())
    with (
        locked(tmp_path / "held"),
        pytest.raises(RacinesError, match="another process has been"),
        locked(tmp_path / "held", 0.1),
    ):
        pass


@pytest.mark.parametrize("what", ["name", "file", "alike"])
def test_two_submissions_at_once_are_taken_one_after_the_other(tmp_path, monkeypatch, what):
    """Both have passed every check before either is in place."""
    names = {"name": ("mine", "mine"), "file": ("mine", "yours"), "alike": ("f1ow", "flow")}[what]
    contents = [tensors(1), tensors(1 if what == "file" else 2)]
    folders = [
        handed_in(tmp_path / f"in{i}", contents[i], name=names[i], authors=[f"Author {i}"])
        for i in range(2)
    ]
    barrier = FORK.Barrier(2)

    def probe(*_):
        barrier.wait(PATIENCE)
        return Probed()

    monkeypatch.setattr(intake, "probe", probe)
    out = tmp_path / "out"
    done, refused = at_once(*(partial(intake.take_in, folder, out) for folder in folders))
    said = {"name": "is taken", "file": "already: hand in", "alike": "looks like"}[what]
    assert done == "done" and said in refused, refused
    (kept,) = (out / "generators").iterdir()
    document = read_document(kept / "submission.yaml")
    assert document["name"] == kept.name
    assert not list(out.rglob(".*"))


def test_two_collects_at_once_leave_one_dataset(tmp_path, monkeypatch, write_scores):
    """Both have found the board free of another dataset before either writes."""
    barrier, check = FORK.Barrier(2), boards.one_dataset
    met = []

    def one_dataset(*words):
        check(*words)
        if not met:
            met.append(barrier.wait(PATIENCE))

    monkeypatch.setattr(boards, "one_dataset", one_dataset)
    other = hashlib.sha256(b"other").hexdigest()
    folders = [
        write_scores("a", generator_scores("a")),
        write_scores("b", generator_scores("b", recipe=other)),
    ]
    results = tmp_path / "results"
    jobs = [partial(boards.collect, [each], results, tmp_path, "b") for each in folders]
    done, refused = at_once(*jobs)
    assert done == "done" and "rests on recipe" in refused
    assert len(list(results.rglob("*.json"))) == 1


def test_a_file_is_handed_in_once(tmp_path):
    intake.take_in(handed_in(tmp_path / "a", name="mine"), tmp_path / "out")
    with pytest.raises(RacinesError, match=r"w\.safetensors: handed in as generators/mine"):
        intake.take_in(handed_in(tmp_path / "b", name="yours"), tmp_path / "out")
    with pytest.raises(RacinesError, match=r"w\.safetensors: handed in as generators/mine"):
        intake.look_at(tmp_path / "b", tmp_path / "out")  # `submit --check`
    intake.look_at(tmp_path / "a", tmp_path / "out")  # what took the name
    intake.take_in(tmp_path / "a", tmp_path / "out", replace=True)


def test_one_artefact_is_no_two(tmp_path):
    folder = handed_in(tmp_path / "in")
    (folder / "v.safetensors").write_bytes(SAFETENSORS)
    entries = [artefact("weights", folder / name) for name in ("w.safetensors", "v.safetensors")]
    path = write_submission(folder, *entries)
    with pytest.raises(RacinesError, match=r"artefacts\.1: the same as artefacts\.0"):
        read_document(path)


@pytest.mark.parametrize(
    "digest",
    ["0" * 64, "f" * 64, "ab" * 32, "deadbeef" * 8, "0123456789abcdef" * 4,
     hashlib.sha256(b"").hexdigest(), hashlib.sha256(b"\n").hexdigest()],
)  # fmt: skip
def test_placeholders_are_no_digests(tmp_path, digest):
    dataset = {"source": "phantom", "version": "1.0.0", "digest": digest}
    with pytest.raises(RacinesError, match=r"dataset\.digest: .* is a placeholder"):
        read_document(write_submission(tmp_path, dataset=dataset))
    far = {"kind": "weights", "path": "w.safetensors", "url": "https://example.org/w"}
    with pytest.raises(RacinesError, match=r"artefacts\.0\.sha256: .* is a placeholder"):
        read_document(write_submission(tmp_path, far | {"sha256": digest, "size": 1}))
    assert not made_up(DIGEST) and not made_up(hashlib.sha256(b"x").hexdigest())


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"authors": ["YOUR NAME"]}, r"authors\.0: 'YOUR NAME': fill them in"),
        ({"method": "A FEW WORDS FOR THE TABLE"}, "method: .*fill them in"),
        ({"training": {"budget": "b", "hardware": "WHAT IT RAN ON"}}, r"training\.hardware"),
        ({"code": {"url": "https://example.org/x", "commit": "0000000"}}, "code.commit"),
        ({"authors": ["Ann Ray", "ANN RAY"]}, r"authors\.1: .* looks like"),
        ({"authors": ["Ann Ray", "\uff21\uff4e\uff4e Ray"]}, r"authors\.1: .* looks like"),
        ({"authors": ["Rene\u0301"]}, "not in Unicode's form NFC"),
    ],
)
def test_what_is_not_filled_in_or_looks_like_another_is_refused(tmp_path, changes, message):
    with pytest.raises(RacinesError, match=message):
        read_document(write_submission(tmp_path, **changes))


def test_the_templates_blanks_are_those_that_are_refused():
    assert all(blank in TEXT for blank in BLANKS)


def test_names_of_this_repository_do_not_look_alike():
    for track in ("generators", "agents"):
        found = {path.stem for path in (ROOT / "leaderboard/results").glob(f"*/{track}/*.json")}
        found |= {path.name for path in (ROOT / "leaderboard/submissions" / track).iterdir()}
        assert len({skeleton(name) for name in found}) == len(found) > 5


@pytest.mark.parametrize("other", ["MINE", "m1ne", "mi-ne", "\uff4dine", "mi_ne"])
def test_a_name_that_looks_like_anothers_is_refused(tmp_path, other):
    """The folder of the other may have come by another road than `racines submit`."""
    (tmp_path / "out/generators" / other).mkdir(parents=True)
    with pytest.raises(RacinesError, match="name: 'mine' looks like"):
        intake.take_in(handed_in(tmp_path / "in"), tmp_path / "out")


def test_a_record_of_another_result_stays(tmp_path, write_scores):
    results, scores = tmp_path / "results", generator_scores("mine")
    (path,) = boards.collect([write_scores("g", scores)], results, tmp_path, "b")
    first = path.read_bytes()
    again = scores | {"seconds": 9.0, "code": {"version": "0.2.0"}}
    boards.collect([write_scores("g", again)], results, tmp_path, "b")  # the same, measured again
    better = write_scores("h", generator_scores("mine", ssim=0.9))
    path.write_bytes(first)
    with pytest.raises(RacinesError, match=r"mine\.json: holds another result.*scores: --force"):
        boards.collect([better], results, tmp_path, "b")
    assert path.read_bytes() == first
    boards.collect([better], results, tmp_path, "b", force=True)
    assert json.loads(path.read_text())["scores"]["metrics"]["ssim"]["value"] == 0.9
    with pytest.raises(RacinesError, match="another folder has scores of that name"):
        boards.collect([better, write_scores("k", scores)], results, tmp_path, "b", force=True)
    with pytest.raises(RacinesError, match="'m1ne' looks like 'mine'"):
        boards.collect([write_scores("l", generator_scores("m1ne"))], results, tmp_path, "b")
