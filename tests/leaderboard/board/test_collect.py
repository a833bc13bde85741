import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from racines_data.errors import RacinesError
from racines_leaderboard.board.collect import boards, collect, made_elsewhere, read_board
from racines_leaderboard.cli.command import app
from racines_leaderboard.records.schema import sealed
from racines_leaderboard.submissions.document import find_submission
from tests.leaderboard.conftest import agent_scores, generator_scores, write_submission


def submission(folder: Path, name: str, track: str, said: str | None = None) -> Path:
    place = folder / track / name
    place.mkdir(parents=True)
    write_submission(place, name=name, track=said or track)
    return place


def test_scores_become_records_of_a_board(tmp_path, write_scores):
    generators = write_scores("g", generator_scores("one"), generator_scores("two"))
    agents = write_scores("a", agent_scores("ppo"))
    submission(tmp_path / "submissions", "two", "generators")
    results = tmp_path / "results"
    written = collect([generators, agents], results, tmp_path / "submissions", "phantom-smoke")
    assert {path.relative_to(results).as_posix() for path in written} == {
        "phantom-smoke/generators/one.json",
        "phantom-smoke/generators/two.json",
        "phantom-smoke/agents/ppo.json",
    }
    assert boards(results) == ["phantom-smoke"]
    content = read_board(results, "phantom-smoke")
    one, two = content["generators"]
    assert one["tier"] == "self-reported" and one["submission"] is None
    assert two["submission"]["method"] == "a method"
    assert two["scores"] == generator_scores("two")
    assert not list(tmp_path.rglob(".*")), "no temporary file stays"


def test_one_file_of_scores_is_collected_alone(tmp_path, write_scores):
    folder = write_scores("g", generator_scores("one"), generator_scores("two"))
    results, submissions = tmp_path / "results", tmp_path / "submissions"
    (found,) = collect([folder / "one.json"], results, submissions, "phantom-smoke")
    assert found == results / "phantom-smoke/generators/one.json"


def test_scores_that_another_profile_left_stay_out(tmp_path, write_scores):
    """A switch of profile leaves the scores of rows that the new one does not train."""
    old, new, bare = (generator_scores(name) for name in ("old", "new", "bare"))
    old["dataset"]["board"], new["dataset"]["board"] = "phantom-default", "phantom-smoke"
    bare["dataset"].pop("board", None)
    folder = write_scores("g", old, new, bare, agent_scores("ppo"))
    others = made_elsewhere([folder], "phantom-smoke")
    assert others == [folder / "old.json"]
    written = collect([folder], tmp_path / "results", tmp_path, "phantom-smoke", others)
    assert {path.stem for path in written} == {"new", "bare", "ppo"}
    (tmp_path / "params.yaml").write_text("board: phantom-smoke\n")
    words = ["--params", str(tmp_path / "params.yaml"), "--collect", str(folder)]
    words += ["--results", str(tmp_path / "again"), "--submissions", str(tmp_path)]
    done = CliRunner().invoke(app, ["leaderboard", *words])
    assert done.exit_code == 0 and "left out" in done.output and "old.json" in done.output
    assert not list((tmp_path / "again").rglob("old.json"))


def test_runs_of_one_method_share_its_submission_and_tell_their_board(tmp_path, write_scores):
    submission(tmp_path / "submissions", "ppo", "agents")
    mine = agent_scores("ppo-image") | {"submission": "ppo", "board": "phantom-smoke"}
    other = agent_scores("ppo-pl", view="PL") | {"submission": "ppo", "board": "phantom-default"}
    folder = write_scores("g", mine, other)
    others = made_elsewhere([folder], "phantom-smoke")
    assert others == [folder / "ppo-pl.json"]
    (path,) = collect([folder], tmp_path / "r", tmp_path / "submissions", "phantom-smoke", others)
    record = read_board(tmp_path / "r", "phantom-smoke")["agents"][0]
    assert path.stem == record["name"] == "ppo-image"
    assert record["submission"]["name"] == "ppo"


def test_collecting_again_writes_the_same_bytes(tmp_path, write_scores):
    folder = write_scores("g", generator_scores("one"))
    results = tmp_path / "results"
    (path,) = collect([folder], results, tmp_path / "none", "b")
    first = path.read_bytes()
    collect([folder], results, tmp_path / "none", "b")
    assert path.read_bytes() == first


def test_a_reproduced_record_stays_so_while_its_scores_are_the_same(tmp_path, write_scores):
    scores = generator_scores("one")
    folder = write_scores("g", scores)
    (path,) = collect([folder], tmp_path / "results", tmp_path, "tiny")
    keys = ("seeds", "metrics", "weights", "code", "environment")
    earned = {"tier": "reproduced", "reproduced": {key: scores[key] for key in keys}}
    record = sealed(json.loads(path.read_text()) | earned)
    path.write_text(json.dumps(record))
    collect([folder], tmp_path / "results", tmp_path, "tiny")
    assert json.loads(path.read_text()) == record
    scores["metrics"]["ssim"]["value"] += 0.001
    with pytest.raises(RacinesError, match="holds another result, reproduced.*--force"):
        collect([write_scores("g", scores)], tmp_path / "results", tmp_path, "tiny")
    collect([write_scores("g", scores)], tmp_path / "results", tmp_path, "tiny", force=True)
    again = json.loads(path.read_text())
    assert again["tier"] == "self-reported" and "reproduced" not in again


@pytest.mark.parametrize(
    ("scores", "track"), [(generator_scores, "generators"), (agent_scores, "agents")]
)
def test_a_board_stays_on_one_dataset(tmp_path, write_scores, scores, track):
    results = tmp_path / "results"
    collect([write_scores("g", scores("old"))], results, tmp_path, "b")
    other = write_scores("h", scores("new", recipe="cd" * 32))
    with pytest.raises(
        RacinesError, match=r"b: .*old\.json rests on recipe [0-9a-f]{12} and .*new"
    ):
        collect([other], results, tmp_path, "b")
    assert [record["name"] for record in read_board(results, "b")[track]] == ["old"]


def damage(document: dict, path: str, value: object) -> dict:
    node = document
    *parents, last = path.split(".")
    for key in parents:
        node = node[key]
    if value is None:
        del node[last]
    else:
        node[last] = value
    return document


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("schema", "other/9", "schema: 'other/9' is none of"),
        ("metrics.ssim.n", -1, r"metrics\.ssim\.n"),
        ("metrics.ssim.value", "high", r"metrics\.ssim\.value"),
        ("metrics.fid", None, "metrics: 'fid' is a required"),
        ("dataset.version", "one", r"dataset\.version"),
        ("generator", "Bad Name", "generator"),
        ("surprise", 1, "surprise"),
    ],
)
def test_damaged_scores_name_file_and_field(tmp_path, write_scores, field, value, message):
    folder = write_scores("g")
    path = folder / "one.json"
    path.write_text(json.dumps(damage(generator_scores("one"), field, value)))
    with pytest.raises(RacinesError, match=rf"one\.json: .*{message}"):
        collect([folder], tmp_path / "results", tmp_path, "b")
    assert not (tmp_path / "results").exists()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{"schema": ', "not readable as JSON"),
        ('{"schema": NaN}', "holds NaN"),
        ('{"schema": -Infinity}', "holds -Infinity"),
        ('{"schema": 1e999}', "holds 1e999"),
        ("[" * 100_000, "not readable"),
        ("[]", "object"),
    ],
)
def test_broken_json_is_refused(tmp_path, write_scores, text, message):
    folder = write_scores("g")
    (folder / "one.json").write_text(text)
    with pytest.raises(RacinesError, match=rf"one\.json: .*{message}"):
        collect([folder], tmp_path / "results", tmp_path, "b")


def test_an_empty_folder_is_refused(tmp_path):
    with pytest.raises(RacinesError, match="no scores"):
        collect([tmp_path / "absent"], tmp_path / "results", tmp_path, "b")


def test_a_record_in_the_wrong_place_is_refused(tmp_path, write_scores):
    results = tmp_path / "results"
    (path,) = collect([write_scores("g", generator_scores("one"))], results, tmp_path, "b")
    path.rename(path.with_name("two.json"))
    with pytest.raises(RacinesError, match=r"two\.json: name: 'one', expected 'two'"):
        read_board(results, "b")


def test_scores_of_the_other_track_than_the_submission(tmp_path, write_scores):
    submission(tmp_path / "submissions", "one", "generators", said="agents")
    folder = write_scores("g", generator_scores("one"))
    with pytest.raises(RacinesError, match="track: 'agents', expected 'generators'"):
        collect([folder], tmp_path / "results", tmp_path / "submissions", "b")


def test_a_submission_is_found_only_where_it_belongs(tmp_path):
    folder = tmp_path / "submissions"
    place = submission(folder, "one", "generators")
    assert find_submission(folder, "generators", "one") and (
        find_submission(folder, "agents", "one") is None
    )
    (place / "more.pkl").write_bytes(b"x")
    with pytest.raises(RacinesError, match="more.pkl: no artefact"):
        find_submission(folder, "generators", "one")
    (place / "more.pkl").unlink()
    place.rename(folder / "one")
    with pytest.raises(RacinesError, match="move it to .*generators/one"):
        find_submission(folder, "generators", "one")
    (folder / "generators" / "one").symlink_to(folder / "one")
    (folder / "one").rename(tmp_path / "elsewhere")
    with pytest.raises(RacinesError, match="symbolic link"):
        find_submission(folder, "generators", "one")


def test_a_record_of_an_earlier_version_is_still_read(tmp_path, write_scores):
    results = tmp_path / "results"
    (path,) = collect([write_scores("g", generator_scores("one"))], results, tmp_path, "b")
    record = json.loads(path.read_text())
    record["submission"] = {
        "name": "one", "track": "generators", "authors": ["A"], "method": "m", "source": "s",
        "licence": "MIT", "description": "d",
    }  # fmt: skip
    path.write_text(json.dumps(record))
    assert read_board(results, "b")["generators"] == [record]
    record["submission"]["pickle"] = "p"
    path.write_text(json.dumps(record))
    with pytest.raises(RacinesError, match="submission"):
        read_board(results, "b")
