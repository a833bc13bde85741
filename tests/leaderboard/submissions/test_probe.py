"""The contract, tried on what is handed in: each clause has something that breaks it."""

import json
from functools import partial
from pathlib import Path

import pytest
import torch
from typer.testing import CliRunner

from racines_data.store.frames import open_store
from racines_envs.agents.contract import CLAUSES as OF_AGENTS
from racines_envs.agents.onnx.policy import OnnxPolicyAgent, export_run
from racines_leaderboard.board.recompute import recompute
from racines_leaderboard.cli.command import app
from racines_leaderboard.submissions.intake import look_at, take_in
from racines_leaderboard.submissions.probe import (
    Probed,
    _adapter,
    _generator,
    _policy,
    _predictions,
)
from racines_models.contract import CLAUSES, ContractError
from racines_models.exchange.onnx.generator import OnnxGenerator
from racines_models.exchange.predictions.file import Predictions, Task, write_predictions
from racines_models.sample import take_sample
from tests.conftest import ROOT
from tests.leaderboard.conftest import artefact, write_submission
from tests.leaderboard.graphs import (
    blind_policy,
    sound_generator,
    sound_policy,
    spoilt_generator,
)
from tests.leaderboard.handed_in import inbox, submitted

GENERATORS = {"track": "generators"}
SHA = "0123456789abcde" * 4


@pytest.fixture
def store(tiny_root):
    return open_store(tiny_root)


def tried(path: Path, store=None) -> Probed:
    """Try the contract on a graph in this process; the second one is opened anew."""
    found, again = Probed(), lambda given: OnnxGenerator(path).generate(*given.values())
    _generator(OnnxGenerator(path), SHA, "set {key}", again, store, None, found)
    return found


def acted(path: Path) -> Probed:
    found = Probed()

    def again(given):
        seeds = given.pop("seeds")
        return OnnxPolicyAgent(path).act(given, seeds)

    _policy(OnnxPolicyAgent(path), SHA, again, None, "SC", found)
    return found


def test_a_sound_generator_keeps_every_clause(tmp_path, store):
    path = sound_generator(tmp_path / "m.onnx")
    found = tried(path, store)
    assert found.held == set(CLAUSES) and not found.untold
    blind = tried(path)
    assert blind.held == set(CLAUSES) and list(blind.untold) == ["G7, shuffled"]
    plain = sound_generator(tmp_path / "p.onnx", steep=0.0, conditional="false")
    assert tried(plain, store).held == set(CLAUSES)


@pytest.mark.parametrize(
    ("write", "clause", "said"),
    [
        (partial(sound_generator, speckle=0.0), "G6", "declared stochastic = true, but the seed"),
        (partial(sound_generator, steep=0.0), "G7", "declared conditional = true, but the pose"),
        (partial(sound_generator, conditional="false"), "G7", "the pose changes the image"),
        (partial(sound_generator, stochastic=None), "G6", "undeclared whether the seed"),
        (partial(sound_generator, conditional=None), "G7", "undeclared whether the pose"),
        (partial(sound_generator, steep=6.0), "G7", "scores do not fall"),
        (partial(spoilt_generator, how="one pixel"), "G7", "scores do not fall"),
        (partial(spoilt_generator, how="batch"), "G5", "depends on its batch"),
        (partial(spoilt_generator, how="chance"), "G3", "give other images"),
        (partial(spoilt_generator, how="black"), "G2", "black|near-constant|0-1"),
    ],
    ids=["seed ignored", "pose ignored", "pose obeyed", "seed untold", "pose untold", "inverted",
         "one pixel", "batch", "chance", "black"],
)  # fmt: skip
def test_a_graph_that_breaks_a_clause_is_refused_by_its_name(tmp_path, store, write, clause, said):
    with pytest.raises(ContractError, match=rf"clause {clause} .*{CLAUSES[clause]}.*({said})"):
        tried(write(tmp_path / "m.onnx"), store)


@pytest.mark.parametrize(
    ("write", "clause", "said"),
    [
        (partial(blind_policy, sees="params"), "A6", "declares to see params"),
        (partial(blind_policy, sees="multimodal"), "A6", "declares to see image"),
        (partial(blind_policy, sees="batch"), "A4", "depends on its batch"),
        (partial(sound_policy, temperature="1e-9"), "A5", "the seed changes no action"),
    ],
    ids=["nothing", "no image", "batch", "seed"],
)
def test_a_policy_that_breaks_a_clause_is_refused_by_its_name(tmp_path, write, clause, said):
    with pytest.raises(ContractError, match=rf"clause {clause} .*{OF_AGENTS[clause]}.*{said}"):
        acted(write(tmp_path / "m.onnx"))


@pytest.mark.parametrize(
    "name",
    ["ppo", "behaviour-cloning", "dqn", pytest.param("ppo-image", marks=pytest.mark.thorough)],
)
def test_the_published_policies_keep_every_clause(name, tmp_path):
    path = ROOT / f"envs/weights/{name}.onnx"
    if not path.is_file():  # a large one is exported when it is wanted
        path = tmp_path / path.name
        export_run(ROOT / f"envs/weights/{name}", path)
    assert acted(path).held == set(OF_AGENTS)


def test_a_merged_class_is_asked_in_a_new_process_too(tmp_path, store, monkeypatch):
    from tests.leaderboard import merged

    monkeypatch.chdir(tmp_path)
    found = Probed()
    _adapter("tests.leaderboard.merged:Steady", GENERATORS, store, None, "SC", found)
    assert not found.held and "no run of it in models/runs/steady" in str(found.untold)
    for cls in (merged.Steady, merged.Moody, merged.Silent):
        cls().save(Path("models/runs") / cls.name)
    _adapter("tests.leaderboard.merged:Steady", GENERATORS, store, None, "SC", found)
    assert found.held == set(CLAUSES)
    with pytest.raises(ContractError, match="clause G4 .*new process"):
        _adapter("tests.leaderboard.merged:Moody", GENERATORS, store, None, "SC", Probed())
    with pytest.raises(ContractError, match="clause G7 .*undeclared .*give its card conditional"):
        _adapter("tests.leaderboard.merged:Silent", GENERATORS, store, None, "SC", Probed())


class Drawn:
    """Images by a rule, with what it declares."""

    def __init__(self, rule, **told):
        self.rule, self.stochastic, self.conditional = rule, None, None
        self.__dict__ |= told

    def draw_frames(self, frames, seed):
        return self.rule(frames.images, seed)


def images_of(tmp_path, store, rule, seeds=(0, 1), **told) -> Probed:
    task = Task(store, take_sample(store, "test", 32), "test", seeds)
    write_predictions(tmp_path / "p.parquet", task, Drawn(rule, **told), "drawn")
    found = Probed()
    _predictions(Predictions(tmp_path / "p.parquet", store), "p.parquet", store, found)
    return found


def test_predictions_show_what_images_can(tmp_path, store):
    both = {"stochastic": True, "conditional": True}
    found = images_of(tmp_path, store, lambda x, seed: x // 2 + seed, **both)
    assert found.held == {"G1", "G2", "G6", "G7"} and set(found.untold) == {"G3", "G4", "G5"}
    one = images_of(tmp_path, store, lambda x, seed: x // 2 + seed, (0,), **both)
    assert one.untold["G6"] == "images of one seed"
    refusals = {
        "G6.*undeclared": (lambda x, seed: x, {"conditional": True}),
        "G6.*changes no image": (lambda x, seed: x // 2, both),
        "G6.*changes the image": (lambda x, seed: x // 2 + seed, both | {"stochastic": False}),
        "G7.*do not fall": (lambda x, seed: x.roll(seed + 11, 0), both),
        "G7.*declare conditional = true": (
            lambda x, seed: x // 2, {"stochastic": False, "conditional": False}
        ),
    }  # fmt: skip
    for message, (rule, told) in refusals.items():
        with pytest.raises(ContractError, match=message):
            images_of(tmp_path, store, rule, **told)


def test_the_probe_stands_before_submission_check_and_scores(ground, tmp_path, monkeypatch):
    digest = open_store(ground.data).manifest["digest"]
    told = {"dataset": {"source": "phantom", "version": "1.0.0", "digest": digest}}
    folder = inbox(tmp_path, "in")
    entry = artefact("generator", sound_generator(folder / "m.onnx", steep=6.0))
    write_submission(folder, entry, tier="recomputed", **told)
    for attempt in (take_in, look_at):
        with pytest.raises(ContractError, match=r"m\.onnx: clause G7 .*scores do not fall"):
            attempt(folder, tmp_path / "out", data=ground.data, limits=ground.limits)
    assert not (tmp_path / "out").exists()
    # Without the dataset that cannot be told; with it, nothing is scored.
    taken = submitted(tmp_path, "generator", folder / "m.onnx", digest)
    with pytest.raises(ContractError, match=r"m\.onnx: clause G7"):
        recompute(taken, ground, tmp_path / "results")
    assert not (tmp_path / "results").exists()


def test_the_command_says_which_clauses_hold(ground, tmp_path):
    digest = open_store(ground.data).manifest["digest"]
    folder = inbox(tmp_path, "in")
    entry = artefact("policy", sound_policy(folder / "line.onnx"))
    told = {"dataset": {"source": "phantom", "version": "1.0.0", "digest": digest}}
    write_submission(folder, entry, track="agents", tier="recomputed", **told)
    done = CliRunner().invoke(app, ["submit", "in", "--check"], catch_exceptions=False)
    assert "Contract: A1, A2, A3, A4, A5, A6 hold." in done.stdout
    done = CliRunner().invoke(app, ["submit", "in", "--check", "--json"], catch_exceptions=False)
    assert json.loads(done.stdout)["contract"] == {"held": sorted(OF_AGENTS), "untold": {}}


def test_probes_differ_from_file_to_file():
    from racines_leaderboard.submissions.probe import _seeds

    assert not torch.equal(_seeds("a1" * 32, 4), _seeds("a2" * 32, 4))
