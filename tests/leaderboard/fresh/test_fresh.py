"""Entries drawn in secret: what looked the truth up is flagged, what did not is not."""

import hashlib
import json
import shutil
from dataclasses import replace
from types import SimpleNamespace

import pytest
import torch
import yaml
from typer.testing import CliRunner

from racines_data.errors import RacinesError
from racines_data.phantom.config import recorded_phantom
from racines_data.phantom.model import shared_phantom
from racines_data.store.frames import open_store
from racines_envs.agents.onnx.policy import OnnxPolicyAgent
from racines_envs.cli.settings import phantom_config
from racines_envs.evaluation.run import EvaluationConfig, evaluate, record_trace
from racines_envs.worlds.making import make_phantom, phantom_recipe
from racines_leaderboard.board import recompute as module
from racines_leaderboard.board.pages import write_page
from racines_leaderboard.board.recompute import Ground, recompute
from racines_leaderboard.cli.command import app
from racines_leaderboard.fresh import draws
from racines_leaderboard.fresh.compare import Side
from racines_leaderboard.fresh.draws import draw_in_secret
from racines_leaderboard.fresh.flags import flags_in, flags_of
from racines_leaderboard.fresh.frames import draw_frames
from racines_leaderboard.fresh.rounds import Secret, commit, reveal
from racines_leaderboard.records.schema import sealed
from racines_leaderboard.submissions.confined.session import Limits
from racines_models.exchange.onnx.generator import OnnxGenerator
from racines_models.exchange.predictions.file import Task, write_predictions
from racines_models.sample import draw, take_sample
from racines_models.scores import scoring
from tests.conftest import TINY, command
from tests.leaderboard.conftest import artefact, generator_scores, write_submission
from tests.leaderboard.graphs import lookup_generator, lookup_policy, sound_generator, sound_policy
from tests.leaderboard.handed_in import Watched, inbox
from tests.models.scores.test_scores import Coarse
from tests.waiting import PATIENCE

NONCE = hashlib.sha256(b"a test's own").digest()
SECRET = Secret("tiny", 1, NONCE)
DAY = "2026-01-31"
SETTINGS = TINY | {
    "data": {
        "frames": 240,
        "workers": 1,
        "phantom": {"shortest": 4, "longest": 8, "phantom": {"block": {"voxel": 0.004}}},
    },
    "scores": {"samples": 24, "resamples": 20, "speed": False},
}
"""A coarse phantom, and six test trajectories of a few frames."""


@pytest.fixture(scope="module")
def data(made_once):
    return made_once("drawn-in-secret", build) / "racines"


def build(folder):
    (folder / "params.yaml").write_text(yaml.safe_dump(SETTINGS))
    command(folder, "racines", "data", "build", "--out", "racines")


@pytest.fixture
def store(data):
    return open_store(data)


@pytest.fixture
def ground(data, tmp_path, monkeypatch):
    """The ground of a tiny board with an open round."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(scoring, "InceptionFeatures", Coarse)
    limits = Limits(memory=2**30, open_seconds=int(PATIENCE), call_seconds=int(PATIENCE))
    board = tmp_path / "results/tiny/agents"
    board.mkdir(parents=True)
    (board / "first.json").write_text(json.dumps(generator_scores("first")))  # the board is there
    commit(tmp_path / "results", "tiny", NONCE, DAY, tmp_path / "nonce.json")
    (board / "first.json").unlink()
    return Ground("tiny", SETTINGS, data, grader=None, limits=limits)


@pytest.fixture
def quick(ground, monkeypatch):
    """The same ground, where files are believed: confinement and probe have their own tests."""
    monkeypatch.setattr(draws, "SCANS", 6)
    monkeypatch.setattr(module, "_try_contract", lambda *_: None)
    monkeypatch.setattr(module, "check_content", lambda *_: None)
    monkeypatch.setattr(module.confined, "ConfinedGenerator", lambda path, _: OnnxGenerator(path))
    monkeypatch.setattr(module.confined, "ConfinedPolicyAgent", lambda p, _: OnnxPolicyAgent(p))
    return ground


def put(root, digest, *artefacts, **changes):
    """Put a submission in its place as it stands; return its folder."""
    kind = artefacts[0][0]
    track = "agents" if kind in ("policy", "trace") else "generators"
    folder = root / "leaderboard/submissions" / track / changes.get("name", "mine")
    folder.mkdir(parents=True, exist_ok=True)
    for _, path in artefacts:
        shutil.copy(path, folder)
    dataset = {"source": "phantom", "version": "1.0.0", "digest": digest}
    told = {"track": track, "dataset": dataset, "tier": "recomputed"} | changes
    write_submission(folder, *(artefact(kind, path) for kind, path in artefacts), **told)
    return folder


def drawn(ground, root, *artefacts, digest=None, **changes):
    """Hand files in, score them again, draw them in secret; return what was written."""
    digest = digest or open_store(ground.data).manifest["digest"]
    folder = put(root, digest, *artefacts, **changes)
    recompute(folder, ground, root / "results")
    return draw_in_secret(folder, ground, root / "results", SECRET, DAY)


def table(store):
    """Every frame of the dataset, the test split among them."""
    return store.parameters, store.images


def test_a_lookup_of_the_truth_is_flagged(quick, store, tmp_path):
    path = lookup_generator(inbox(tmp_path, "in") / "m.onnx", *table(store))
    told = drawn(quick, tmp_path, ("generator", path))
    assert [flag.partition(":")[0].partition(" (")[0] for flag in told["flags"]] == [
        "too good",
        "sharp drop from public to secret",
        "lookup",
    ]
    assert told["figures"]["ssim"]["public"]["value"] > 0.999
    assert told["figures"]["ssim"]["secret"]["value"] < 0.9
    assert told["nearer"]["secret"]["ssim"]["value"] < 0 < told["nearer"]["public"]["ssim"]["low"]
    assert told["copies"]["value"] == 1.0
    assert flags_of(tmp_path / "results/tiny", "generators", "mine") == told["flags"]
    assert flags_of(tmp_path / "results/tiny", "generators", "another") == []
    write_page(tmp_path / "page.md", tmp_path / "results")
    assert "Flagged, generators/mine: too good: nearer" in (tmp_path / "page.md").read_text()


def test_a_lookup_that_hides_in_noise_is_flagged(quick, store, tmp_path):
    """As far from the truth as a second scan is, and no copy: the drop alone gives it away."""
    path = lookup_generator(inbox(tmp_path, "in") / "m.onnx", *table(store), noise=5.0)
    told = drawn(quick, tmp_path, ("generator", path))
    assert told["copies"]["value"] == 0.0
    (flag,) = told["flags"]
    assert flag.startswith("sharp drop from public to secret (SSIM")


@pytest.mark.thorough
def test_a_lookup_among_honest_trainings_is_flagged(quick, store, tmp_path):
    folder = inbox(tmp_path, "in")
    paths = [sound_generator(folder / "a.onnx"), sound_generator(folder / "b.onnx", 0.03)]
    paths.append(lookup_generator(folder / "c.onnx", *table(store), noise=1.0))
    told = drawn(quick, tmp_path, *(("generator", path) for path in paths))
    assert any(flag.startswith("too good") for flag in told["flags"])


class Truth:
    """Hands the frames themselves in."""

    card = SimpleNamespace(stochastic=False, conditional=True)

    def draw_frames(self, frames, seed):
        return frames.images


def test_the_truth_handed_in_is_flagged(quick, store, tmp_path):
    path = inbox(tmp_path, "in") / "drawn.parquet"
    task = Task(store, take_sample(store, "test", 24), "test", (0,))
    write_predictions(path, task, Truth(), "truth")
    told = drawn(quick, tmp_path, ("predictions", path))
    assert told["flags"][0].startswith("not recomputable in secret: images are no program")
    assert told["flags"][1].startswith("too good: nearer to the truth than the truth drawn again")
    assert told["basis"] is None and told["figures"]["ssim"]["secret"] is None


def test_honest_generators_are_not_flagged(quick, store, tmp_path):
    train = store.images[store.split_indices("train")]
    mean = train.float().mean(0, keepdim=True).round().to(torch.uint8)
    path = inbox(tmp_path, "one") / "mean.onnx"
    lookup_generator(path, store.parameters[:1], mean, conditional="false")
    stripes = sound_generator(inbox(tmp_path, "two") / "stripes.onnx")
    for name, each in (("mean", path), ("stripes", stripes)):
        told = drawn(quick, tmp_path, ("generator", each), name=name)
        assert told["flags"] == [] and told["copies"]["value"] == 0.0
        figure = told["figures"]["ssim"]
        assert abs(figure["public"]["value"] - figure["secret"]["value"]) < 0.1
        assert figure["public"] != figure["secret"]


@pytest.mark.thorough
def test_the_truth_drawn_again_is_not_too_good(store):
    """Nor is the mean of many scans, which is nearer to the frame than any one of them."""
    phantom = shared_phantom(recorded_phantom(store.manifest))

    class Mean:
        def generate(self, parameters, seed):
            scans = [phantom.generate(parameters, seed + 7 * k).float() for k in range(12)]
            return torch.stack(scans).mean(0).round().to(torch.uint8)

    fresh = draw_frames(store, "test", SECRET)
    for frames in (store, fresh):
        sample = take_sample(frames, "test", 48)
        again = draw(phantom, sample.frames, 99)
        for source in (phantom, Mean()):
            side = Side.drawn(frames, sample, [source], (50,))
            found = side.nearer(range(1, 17))
            assert all(each.high is not None and each.low <= 0 for each in found.values())
            if frames is fresh:
                assert side.copies(store).value == 0.0
        # Half of the noise away: nobody who does not know the frame gets there.
        half = (again.float() + sample.frames.images.float()) / 2
        near = (half * 0.4 + sample.frames.images.float() * 0.6).round().to(torch.uint8)
        found = Side(frames, sample, [[near]]).nearer(range(1, 17))
        assert all(each.low is not None and each.low > 0 for each in found.values())


def test_fresh_frames_are_others_of_the_same_kind(store, warm_workers):
    fresh = draw_frames(store, "test", SECRET)
    again = draw_frames(store, "test", SECRET, workers=2)
    other = draw_frames(store, "test", Secret("tiny", 2, NONCE))
    assert fresh.digest == again.digest != other.digest
    assert torch.equal(fresh.images, again.images)
    rows, mine = store.split_indices("test"), fresh.split_indices("test")
    assert not len(fresh.split_indices("train")) and len(mine) == len(fresh)
    counts = (len(store.trajectory_index[rows].unique()), len(fresh.trajectories))
    assert abs(counts[0] - counts[1]) <= 1
    views = [store.target_views[i] for i in store.trajectory_index[rows].unique().tolist()]
    assert sorted(fresh.target_views) == sorted(views)
    assert {4, 5, 6, 7, 8} >= set(fresh.trajectory_index.bincount().tolist())
    apart = torch.cdist(fresh.parameters[:, 6:9] * 1e3, store.parameters[:, 6:9] * 1e3)
    assert float(apart.amin(1).median()) > 0.1  # mm
    batch = fresh.take(mine[:3])
    assert torch.equal(batch.images, fresh.images[:3]) and batch.parameters.shape == (3, 12)


def test_recorded_data_cannot_be_drawn_anew(store):
    store.manifest = store.manifest | {"source": "tracked", "recipe": {"settings": {}}}
    with pytest.raises(RacinesError, match="source tracked: recorded data cannot be drawn anew"):
        draw_frames(store, "test", SECRET)


def test_a_policy_starts_afresh_and_a_trace_cannot(quick, tmp_path):
    phantom = make_phantom(phantom_config(SETTINGS))
    recipe = phantom_recipe(phantom)
    assert recipe is not None
    path = sound_policy(inbox(tmp_path, "one") / "policy.onnx")
    digest = recipe["recipe_digest"]
    told = drawn(quick, tmp_path, ("policy", path), digest=digest)
    assert told["flags"] == [] and told["basis"] == {"n": 12, "units": 12, "digest": None}
    figure = told["figures"]["peak_force"]
    assert figure["public"] != figure["secret"] and figure["secret"]["n"] == 12
    trace = inbox(tmp_path, "two") / "trace.json"
    config = EvaluationConfig(starts=4, latency=0)
    record_trace("planner", tmp_path, config, trace, phantom)
    told = drawn(quick, tmp_path, ("trace", trace), digest=digest, name="played")
    (flag,) = told["flags"]
    assert flag.startswith("not recomputable in secret: actions are no program")
    replay = replace(quick, settings=SETTINGS | {"evaluation": {"backend": "replay"}})
    folder = tmp_path / "leaderboard/submissions/agents/mine"
    with pytest.raises(RacinesError, match="recorded data cannot be drawn anew"):
        draw_in_secret(folder, replay, tmp_path / "results", SECRET, DAY)


def test_a_policy_that_knows_the_public_starts_is_flagged(quick, tmp_path):
    phantom = make_phantom(phantom_config(SETTINGS))
    watched = Watched()
    config = EvaluationConfig(starts=4, latency=0)
    evaluate("", tmp_path, config, phantom, agent=watched)
    path = inbox(tmp_path, "in") / "policy.onnx"
    lookup_policy(path, torch.cat(watched.seen), torch.cat(watched.done))
    recipe = phantom_recipe(phantom)
    assert recipe is not None
    told = drawn(quick, tmp_path, ("policy", path), digest=recipe["recipe_digest"])
    (flag,) = told["flags"]
    assert flag.startswith("sharp drop from public to secret (True success ")


@pytest.mark.thorough
def test_the_file_shows_no_seed_and_cannot_be_made_up(quick, store, tmp_path):
    path = lookup_generator(inbox(tmp_path, "in") / "m.onnx", *table(store))
    told = drawn(quick, tmp_path, ("generator", path))
    results = tmp_path / "results"
    file = results / "tiny/secret/round-1/generators/mine.json"
    text = file.read_text()
    purposes = ("poses", "splits", "drawing/0", "starts/0")
    for hidden in (NONCE.hex(), *(str(SECRET.seed(each)) for each in purposes)):
        assert hidden not in text
    assert json.loads(text) == told
    # The same drawn again leaves it as it is; figures that were made up do not stay.
    folder = tmp_path / "leaderboard/submissions/generators/mine"
    later = draw_in_secret(folder, quick, results, SECRET, "2026-02-01")
    assert later == told and file.read_text() == text
    honest = told["figures"]["ssim"]["secret"] | {"value": 0.999, "low": 0.99, "high": 1.0}
    better = told | {
        "figures": told["figures"] | {"ssim": told["figures"]["ssim"] | {"secret": honest}}
    }
    edits = {
        "seal": (told | {"flags": []}),
        "flags": sealed(told | {"flags": []}),
        "commitment": sealed(told | {"commitment": "ab" * 32}),
        "belongs in": sealed(told | {"name": "another"}),
        "nonce": sealed(told | {"nonce": NONCE.hex()}),
        "belongs in .*round-2": sealed(told | {"round": 2}),
    }
    for message, edit in edits.items():
        file.write_text(json.dumps(edit))
        with pytest.raises(RacinesError, match=message):
            flags_of(results / "tiny", "generators", "mine")
    better["flags"] = flags_in(better)
    file.write_text(json.dumps(sealed(better)))
    with pytest.raises(RacinesError, match="other draws of this round.*figures"):
        draw_in_secret(folder, quick, results, SECRET, DAY)
    # What is drawn once the nonce is public proves nothing, and says so.
    file.unlink()
    reveal(results, SECRET, DAY)
    late = draw_in_secret(folder, quick, results, SECRET, DAY)
    assert late["flags"] == [*told["flags"], "drawn after the reveal, when the draws were public"]
    unknown = Secret("tiny", 1, hashlib.sha256(b"favourable").digest())
    with pytest.raises(RacinesError, match="no commitment to this nonce"):
        draw_in_secret(folder, quick, results, unknown, DAY)


@pytest.mark.thorough
def test_flags_of_a_former_file_are_told_apart(quick, store, tmp_path):
    path = lookup_generator(inbox(tmp_path, "in") / "m.onnx", *table(store))
    told = drawn(quick, tmp_path, ("generator", path))
    sound_generator(path)
    folder = put(tmp_path, store.manifest["digest"], ("generator", path))
    with pytest.raises(RacinesError, match="not recomputed from the files of the submission"):
        draw_in_secret(folder, quick, tmp_path / "results", SECRET, DAY, force=True)
    recompute(folder, quick, tmp_path / "results", force=True)
    flags = flags_of(tmp_path / "results/tiny", "generators", "mine")
    assert flags == [*told["flags"], "fresh draws are of an earlier file"]
    draw_in_secret(folder, quick, tmp_path / "results", SECRET, DAY, force=True)
    assert flags_of(tmp_path / "results/tiny", "generators", "mine") == []


def figures(public: float, secret: float, reach: float = 0.02) -> dict:
    def ends(value):
        return {"value": value, "low": value - reach, "high": value + reach, "n": 300}

    return {"public": ends(public), "secret": ends(secret)}


@pytest.mark.parametrize(
    ("public", "secret", "flagged"),
    [(0.95, 0.40, True), (0.95, 0.82, True), (0.95, 0.83, False), (0.95, 0.90, False),
     (0.40, 0.95, False)],
)  # fmt: skip
def test_a_drop_is_sharp_beyond_interval_and_margin(public, secret, flagged):
    """0.1 of margin and hypot(0.02, 0.02) of interval."""
    document = {
        "track": "agents", "reason": None, "copies": None, "revealed": False,
        "nearer": {"public": None, "secret": None}, "margins": {"success_true": 0.1},
        "figures": {"success_true": figures(public, secret)},
    }  # fmt: skip
    flags = flags_in(document)
    assert bool(flags) is flagged
    if flagged:
        assert flags == [
            f"sharp drop from public to secret (True success 95.0 to {100 * secret:.1f})"
        ]


@pytest.mark.thorough
def test_the_commands_draw_in_secret(ground, store, tmp_path):
    (tmp_path / "params.yaml").write_text(yaml.safe_dump(SETTINGS))
    path = lookup_generator(inbox(tmp_path, "in") / "m.onnx", *table(store))
    dataset = {"source": "phantom", "version": "1.0.0", "digest": store.manifest["digest"]}
    write_submission(path.parent, artefact("generator", path), dataset=dataset, tier="recomputed")
    common = ["--data", str(ground.data), "--no-grader", "--results", "results"]
    secret = ["--secret", "nonce.json"]
    words = ["submit", "in", *common, "--recompute", *secret]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0, done.output
    assert "drawn in secret, round 1: generators/mine: too good" in done.stderr
    done = CliRunner().invoke(app, ["leaderboard", "--recompute", "mine", *common, *secret])
    assert done.exit_code == 0 and "lookup: 100 %" in done.stderr, done.output
    for words in (["submit", "in", *secret], ["leaderboard", *secret]):
        done = CliRunner().invoke(app, words)
        assert done.exit_code == 2 and "--secret goes with --recompute" in done.output
