"""Scores made again from what was submitted: those of the road within this process, or none."""

import json
from dataclasses import replace
from types import SimpleNamespace

import pytest
import yaml
from typer.testing import CliRunner

from racines_data.errors import RacinesError
from racines_data.files import sha256_file
from racines_data.store.frames import open_store
from racines_envs.agents.onnx.policy import OnnxPolicyAgent
from racines_envs.evaluation.run import EvaluationConfig, evaluate, record_trace
from racines_envs.worlds.making import make_phantom, phantom_recipe
from racines_leaderboard.board import recompute as module
from racines_leaderboard.board.collect import read_board
from racines_leaderboard.board.recompute import find, recompute
from racines_leaderboard.cli.command import app
from racines_leaderboard.submissions.intake import take_in
from racines_models.exchange.onnx.generator import OnnxGenerator
from racines_models.exchange.predictions.file import Task, write_predictions
from racines_models.sample import take_sample
from racines_models.scores.scoring import score
from racines_models.statistics import Evidence
from tests.conftest import TINY
from tests.leaderboard.conftest import DIGEST, artefact, generator_scores, write_submission
from tests.leaderboard.evidence import evidence
from tests.leaderboard.graphs import harmful, sound_generator, sound_policy
from tests.leaderboard.handed_in import CONFIG, inbox, submitted


def test_a_generator_and_its_predictions_get_the_scores_of_the_open_road(ground, tmp_path):
    store = open_store(ground.data)
    path = sound_generator(inbox(tmp_path, "one") / "mine.onnx")
    wanted = score(OnnxGenerator(path), store, CONFIG, "mine").content["metrics"]
    task = Task(store, take_sample(store, "test", 16), "test", (0,))
    drawn = inbox(tmp_path, "two") / "drawn.parquet"
    write_predictions(drawn, task, OnnxGenerator(path), "stripes")
    recipe = store.manifest["recipe_digest"]
    folders = [
        submitted(tmp_path, "generator", path, store.manifest["digest"]),
        submitted(tmp_path, "predictions", drawn, recipe, name="drawn"),
    ]
    for folder in folders:
        record = recompute(folder, ground, tmp_path / "results")
        # A file of one seed says nothing of how much the seed changes.
        absent = {"diversity"} if folder.name == "drawn" else set()
        expected = {key: value for key, value in wanted.items() if key not in absent}
        assert record["tier"] == "recomputed" and record["scores"]["metrics"] == expected
        entry = record["submission"]["artefacts"][0]
        assert record["scores"]["weights"] == {entry["path"]: entry["sha256"]}
        assert record["scores"]["dataset"]["board"] == "tiny"
    board = read_board(tmp_path / "results", "tiny")
    assert [record["name"] for record in board["generators"]] == ["drawn", "mine"]
    assert board["generators"][1]["scores"]["metrics"] == wanted


def test_what_recomputed_scores_rest_on_lies_beside_their_record(ground, tmp_path, monkeypatch):
    figures, real = evidence(("ssim",), 0.5), module.score

    def scored(*words, **named):
        content = real(*words, **named).content
        content["metrics"]["ssim"] = figures.figures["ssim"].interval(-1.0, 1.0).to_json()
        return SimpleNamespace(content=content, evidence=figures)

    monkeypatch.setattr(module, "score", scored)
    path = sound_generator(inbox(tmp_path, "one") / "mine.onnx")
    digest = open_store(ground.data).manifest["digest"]
    folder = submitted(tmp_path, "generator", path, digest)
    record = recompute(folder, ground, tmp_path / "results")
    beside = tmp_path / "results/tiny/generators/mine.parquet"
    told = {"file": "mine.parquet", "sha256": sha256_file(beside)}
    assert record["scores"]["evidence"] == told
    assert read_board(tmp_path / "results", "tiny")["generators"] == [record]
    assert list(Evidence.read(beside).figures) == ["ssim"]


TWO = (("a.onnx", 0.02), ("b.onnx", 0.03))


@pytest.mark.thorough
def test_two_generators_are_two_seeds_of_one_method(ground, tmp_path):
    digest = open_store(ground.data).manifest["digest"]
    folder = inbox(tmp_path, "in")
    paths = [sound_generator(folder / name, speckle) for name, speckle in TWO]
    dataset = {"source": "phantom", "version": "1.0.0", "digest": digest}
    write_submission(folder, *(artefact("generator", path) for path in paths), dataset=dataset)
    taken = take_in(folder, tmp_path / "leaderboard/submissions").folder
    record = recompute(taken, ground, tmp_path / "results")
    assert record["scores"]["runs"] == 2 and record["scores"]["seeds"] == [0, 1]


def test_policies_are_the_trainings_of_one_method(ground, tmp_path):
    recipe = phantom_recipe(make_phantom(None))
    assert recipe is not None
    folder, config = inbox(tmp_path, "in"), EvaluationConfig(starts=4, latency=0)
    paths = [sound_policy(folder / f"{seed}.onnx", seed) for seed in range(2)]
    dataset = {"source": "phantom", "version": "1.0.0", "digest": recipe["recipe_digest"]}
    about = {"track": "agents", "dataset": dataset, "tier": "recomputed", "seeds": [3, 5]}
    write_submission(folder, *(artefact("policy", path) for path in paths), **about)
    taken = take_in(folder, tmp_path / "leaderboard/submissions").folder
    scores = recompute(taken, ground, tmp_path / "results")["scores"]
    first, *further = [OnnxPolicyAgent(path) for path in paths]
    wanted = evaluate("", tmp_path, config, make_phantom(None), agent=first, further=further).scores
    assert scores["metrics"] == json.loads(json.dumps(wanted["metrics"]))
    assert scores["runs"] == 2 and scores["weights"].keys() == {path.name for path in paths}
    assert [each["seed"] for each in scores["trainings"]] == [3, 5]
    alone = evaluate("", tmp_path, config, make_phantom(None), agent=first).scores
    assert alone["metrics"]["return"]["value"] != scores["metrics"]["return"]["value"]


def test_policies_that_see_differently_are_no_trainings_of_one_method(tmp_path):
    first, other = (OnnxPolicyAgent(sound_policy(tmp_path / f"{k}.onnx", k)) for k in range(2))
    other.observation = "image"
    with pytest.raises(RacinesError, match="training 1 observes image, the first params"):
        evaluate("", tmp_path, EvaluationConfig(starts=2), None, agent=first, further=[other])


def test_a_policy_and_its_trace_get_the_scores_of_the_open_road(ground, tmp_path):
    phantom = make_phantom(None)
    recipe = phantom_recipe(phantom)
    assert recipe is not None
    config = EvaluationConfig(starts=4, latency=0)
    path = sound_policy(inbox(tmp_path, "one") / "policy.onnx")
    opened = OnnxPolicyAgent(path)
    wanted = evaluate("", tmp_path, config, phantom, agent=opened).scores
    trace = inbox(tmp_path, "two") / "trace.json"
    record_trace("", tmp_path, config, trace, phantom, agent=opened)
    folders = [
        submitted(tmp_path, "policy", path, recipe["recipe_digest"]),
        submitted(tmp_path, "trace", trace, recipe["recipe_digest"], name="played"),
    ]
    for folder in folders:
        scores = recompute(folder, ground, tmp_path / "results")["scores"]
        for key in ("metrics", "by_seed", "task", "phantom"):
            assert scores[key] == json.loads(json.dumps(wanted[key])), key
        assert scores["agent"] == folder.name
    with pytest.raises(RacinesError, match="recorded from 4 starts"):
        fewer = replace(ground, settings=TINY | {"evaluation": {"starts": 3}})
        recompute(folders[1], fewer, tmp_path / "results")


def test_other_data_are_refused(ground, tmp_path):
    folder = submitted(
        tmp_path, "generator", sound_generator(inbox(tmp_path, "in") / "m.onnx"), DIGEST
    )
    with pytest.raises(RacinesError, match=f"mine: dataset.digest: {DIGEST}.*score it on the data"):
        recompute(folder, ground, tmp_path / "results")
    assert not (tmp_path / "results").exists()


@pytest.mark.parametrize(
    ("how", "limit", "message"),
    [("loop", {"call_seconds": 1}, "took more than"), ("claim", {}, "memory")],
)
def test_what_breaks_a_limit_leaves_no_record(ground, tmp_path, how, limit, message):
    digest = open_store(ground.data).manifest["digest"]
    folder = tmp_path / "leaderboard/submissions/generators/mine"
    folder.mkdir(parents=True)
    entry = artefact("generator", harmful(folder / "harm.onnx", how))
    dataset = {"source": "phantom", "version": "1.0.0", "digest": digest}
    write_submission(folder, entry, dataset=dataset, tier="recomputed")
    limited = replace(ground, limits=replace(ground.limits, **limit))
    with pytest.raises(RacinesError, match=f"harm.onnx: .*{message}"):  # it comes no further
        take_in(folder, tmp_path / "elsewhere", limits=limited.limits)
    assert not (tmp_path / "elsewhere").exists()
    with pytest.raises(RacinesError, match=f"harm.onnx: .*{message}"):
        recompute(folder, limited, tmp_path / "results")
    assert not (tmp_path / "results").exists()


def test_figures_that_are_not_finite_leave_no_record(ground, tmp_path, monkeypatch):
    digest = open_store(ground.data).manifest["digest"]
    path = sound_generator(inbox(tmp_path, "in") / "m.onnx")
    folder = submitted(tmp_path, "generator", path, digest)
    scores = generator_scores("mine", ssim=float("nan"))
    monkeypatch.setattr(module, "_generator_scores", lambda *_: scores)
    with pytest.raises(RacinesError, match="mine.json: a figure is not finite"):
        recompute(folder, ground, tmp_path / "results")
    assert not (tmp_path / "results").exists()


def test_what_cannot_be_scored_again_says_why(ground, tmp_path):
    submissions = tmp_path / "leaderboard/submissions"
    with pytest.raises(RacinesError, match="'mine': no submission"):
        find(submissions, "mine")
    for track in ("generators", "agents"):
        adapter = {"kind": "adapter", "adapter": "racines_envs.agents.ppo:PPOAgent"}
        write_submission(submissions / track / "mine", adapter, track=track)
    with pytest.raises(RacinesError, match="'mine': on several tracks"):
        find(submissions, "mine")
    with pytest.raises(RacinesError, match="no submission"):
        find(submissions, "../generators/mine")
    folder = find(submissions, "agents/mine")
    with pytest.raises(RacinesError, match="no artefact that can be scored again"):
        recompute(folder, ground, tmp_path / "results")
    far = artefact("generator", tmp_path / "absent.onnx", url="https://example.org/absent.onnx")
    write_submission(submissions / "generators/mine", far)
    with pytest.raises(RacinesError, match="absent.onnx: lies at its URL"):
        recompute(submissions / "generators/mine", ground, tmp_path / "results")


def test_a_file_that_was_changed_in_its_place_is_refused(ground, tmp_path):
    path = sound_generator(inbox(tmp_path, "in") / "m.onnx")
    folder = submitted(tmp_path, "generator", path, DIGEST)
    (folder / "m.onnx").write_bytes(path.read_bytes() + b"\x00")
    with pytest.raises(RacinesError, match="m.onnx: the file has sha256"):
        recompute(folder, ground, tmp_path / "results")


def test_the_command_recomputes_and_shows_the_board(ground, tmp_path):
    digest = open_store(ground.data).manifest["digest"]
    path = sound_generator(inbox(tmp_path, "in") / "m.onnx")
    submitted(tmp_path, "generator", path, digest)
    (tmp_path / "params.yaml").write_text(yaml.safe_dump(TINY))
    words = ["leaderboard", "--recompute", "mine", "--no-grader", "--json"]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0, done.output
    (entry,) = json.loads(done.stdout)["boards"]["tiny"]["generators"]
    assert (entry["name"], entry["tier"]) == ("mine", "recomputed")
