"""Generators on boards of patients: scored by scouts, pinned, ranked, and audited."""

import hashlib
import json
import shutil
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
import torch
import yaml
from PIL import Image
from typer.testing import CliRunner

from racines_data.errors import RacinesError
from racines_data.patients.scouts import FRAMES, POSES
from racines_data.records import encode_png
from racines_data.store.asked import AskedStore
from racines_leaderboard.audit import adapting
from racines_leaderboard.board import recompute
from racines_leaderboard.board.collect import read_board, read_scores
from racines_leaderboard.board.rank import rankings
from racines_leaderboard.board.standing import is_bound
from racines_leaderboard.cli.command import app
from racines_leaderboard.fresh.draws import draw_in_secret
from racines_leaderboard.fresh.rounds import Secret, commit
from racines_leaderboard.records.schema import sealed
from racines_leaderboard.records.tracks import PATIENT_GENERATORS
from racines_models.generators.nearest_pose import NearestPose
from racines_models.scores import features, scoring
from racines_models.scores.adapted_sheet import EDGE, GAP, HEAD, STEP
from racines_models.scores.on_patients import draw_patients, open_for_patients
from tests.conftest import ROOT
from tests.leaderboard.called import racines
from tests.models.scores.test_scores import Coarse

JUDGES = ROOT / "models/weights/phantom-patients"
SETTINGS = {
    "board": "mini",
    "patient_boards": ["patients"],
    "seed": 0,
    "scouts": {"train": 1, "validation": 1, "places": 2},
    "patient_generators": {
        "scout-attention": {"width": 8, "frames": 4, "training": {"images": 32, "batch_size": 16}}
    },
    "patient_scores": {
        "split": "validation", "patients": 2,
        "pose": str(JUDGES / "pose"), "segmentation": str(JUDGES / "segmentation"),
    },
}  # fmt: skip
RESULTS, SCORES = Path("leaderboard/results"), Path("models/runs/scores/patients")
DPI = 110
NAMES = ("mean-image", "noise-ceiling", "nearest-pose", "scout-attention")


@pytest.fixture(scope="module")
def made(made_once) -> Path:
    """A workplace with a board of patients that holds anchors, retrieval, and one that learned."""
    return made_once("adapting-board", make_board)


def make_board(folder: Path) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        coarse(patch)
        Path("params.yaml").write_text(yaml.safe_dump(SETTINGS), encoding="utf-8")
        for name in ("mean-image", "scout-attention"):
            racines("train", "generator", name, "--tier", "patients", "--json")
        for name in NAMES:
            racines("eval", "generator", name, "--tier", "patients", "--json")
        racines("leaderboard", "--board", "patients", "--collect", str(SCORES))
        racines("board", "pin", "patients")


def coarse(patch: pytest.MonkeyPatch) -> None:
    """Put block means in the place of Inception."""
    for module in (features, scoring, adapting, recompute):
        patch.setattr(module, "InceptionFeatures", Coarse)


@pytest.fixture
def board(made, tmp_path, monkeypatch) -> Path:
    coarse(monkeypatch)
    shutil.copytree(made, tmp_path / "work")
    monkeypatch.chdir(tmp_path / "work")
    return tmp_path / "work"


def test_scores_say_who_adapts_and_how_well_by_stratum(board):
    told = {name: read_scores(SCORES / f"{name}.json") for name in NAMES}
    assert {track.name for _, track in told.values()} == {PATIENT_GENERATORS.name}
    adapts = {name for name, (scores, _) in told.items() if scores["adapts"]}
    assert adapts == {"nearest-pose", "scout-attention"}
    for name, (scores, _) in told.items():
        strata, metrics = scores["by_stratum"], scores["metrics"]
        assert list(strata) == ["0-5 mm", "5-10 mm", "10-15 mm", "15-20 mm"]
        assert metrics["ssim"]["n"] == 64 and strata["0-5 mm"]["ssim"]["n"] == 16
        assert metrics["ssim"]["settings"]["units"] == 2, "patients"
        of_strata = [each["ssim"]["value"] for each in strata.values()]
        assert abs(sum(of_strata) / 4 - metrics["ssim"]["value"]) < 1e-9
        assert ("seconds_to_adapt" in metrics) == (name in adapts)
    near = [told["nearest-pose"][0]["by_stratum"][key]["ssim"]["value"]
            for key in ("0-5 mm", "15-20 mm")]  # fmt: skip
    assert near[0] > near[1], "retrieval is worse the further off"


def test_the_picture_differs_in_what_is_drawn_alone(board):
    pictures = [np.asarray(Image.open(SCORES / f"{name}.png")) for name in NAMES[1:3]]
    assert pictures[0].shape == pictures[1].shape and pictures[0].ndim == 2
    differs = (pictures[0] != pictures[1]).any(1)
    for patient in range(2):
        top = HEAD + patient * (3 * STEP + GAP)
        scout, true, drawn = (
            differs[round(DPI * (top + row * STEP)) : round(DPI * (top + row * STEP + EDGE))]
            for row in range(3)
        )
        assert not scout.any() and not true.any() and drawn[DPI // 10 :].any()


def test_anchors_stand_at_their_ends_and_bounds_without_a_place(board):
    records = read_board(RESULTS, "patients")[PATIENT_GENERATORS.name]
    by_name = {each["name"]: each for each in records}
    score = {name: each["standing"].score.value for name, each in by_name.items()}
    assert score["mean-image"] == 0.0 and score["noise-ceiling"] == 1.0
    assert {name for name in NAMES if is_bound(by_name[name])} == set(NAMES[:3])
    why = {each.record["name"]: each.standing.why for each in rankings(PATIENT_GENERATORS, records)}
    assert why == dict.fromkeys(NAMES[:3], "bound") | {"scout-attention": "one training"}
    shown = racines("leaderboard", "--board", "patients")
    assert "Dice" in shown and "scout-attention" in shown


def test_an_audit_makes_every_number_again(board):
    """What a former run has kept may be anything, or damaged: all that is asked is drawn anew.

    What does not train needs no run; handed in for the phantom, whose patients the scouts are of.
    """
    kept = list((board / "models/runs/scores/reference").glob("*.safetensors"))
    assert len(kept) == 2
    for path in kept:
        path.write_bytes(path.read_bytes()[:100])
    (run,) = (board / "models/runs").rglob("mean-image")
    shutil.rmtree(run)
    path = RESULTS / "patients/patient-generators/mean-image.json"
    record = json.loads(path.read_text())
    folder = Path("leaderboard/submissions/patient-generators/mean-image")
    shutil.copytree(ROOT / folder, board / folder)
    document = yaml.safe_load((folder / "submission.yaml").read_text())
    assert document["dataset"]["source"] == "phantom"
    path.write_text(json.dumps(sealed(record | {"submission": document})))
    (board / "leaderboard/results/patients/board.json").unlink()
    racines("board", "pin", "patients")
    said = json.loads(racines("audit", "--all", "--board", "patients", "--json"))
    verdicts = {each["name"]: each["verdict"] for each in said["reports"]}
    assert verdicts == dict.fromkeys(NAMES, "holds"), said


def test_poses_of_another_patient_are_not_drawn(board):
    asked = AskedStore("validation", 2, 0, Path("models/runs/scores/reference"))
    asked.parameters = asked.parameters.roll(POSES, 0)
    with pytest.raises(RacinesError, match="poses of another patient"):
        draw_patients(NearestPose(), asked, 0)


class Noted:
    """Notes the seeds that it is given, and draws what it is told of the frames."""

    scout = 1

    def __init__(self, truth: torch.Tensor) -> None:
        self.truth, self.seeds = truth, []

    def adapt(self, images: torch.Tensor, parameters: torch.Tensor, seed: int) -> "Noted":
        self.seeds.append(seed)
        return self

    def generate(self, parameters: torch.Tensor, seed: torch.Tensor) -> torch.Tensor:
        self.seeds += seed.tolist()
        return self.truth[: len(parameters)]


def test_seeds_differ_by_patient_pose_and_training_and_come_again(board):
    asked = AskedStore("validation", 2, 0, Path("models/runs/scores/reference"))

    def given(seed: int) -> list[int]:
        noted = Noted(asked.images)
        draw_patients(noted, asked, seed)
        return noted.seeds

    first, again, other = given(0), given(0), given(1)
    assert first == again and len(first) == 2 * (1 + POSES)
    assert len(set(first)) == len(first) and not set(first) & set(other)


CHANGED = {
    "record": {("metrics", "dice_lv", "value"): 0.99},
    "by_stratum.0-5 mm.ssim.high, dataset.recipe_digest, scores.adapts": {
        ("by_stratum", "0-5 mm", "ssim", "high"): 0.999,
        ("adapts",): False,
        ("dataset", "recipe_digest"): "0" * 64,
    },
}
"""What is changed in a record at one time, and what each audit says of it."""


@pytest.mark.parametrize(("told", "changes"), CHANGED.items())
def test_what_is_changed_afterwards_does_not_hold(board, told, changes):
    path = RESULTS / "patients/patient-generators/nearest-pose.json"
    record = json.loads(path.read_text())
    for place, value in changes.items():
        node = record["scores"]
        for key in place[:-1]:
            node = node[key]
        node[place[-1]] = value
    path.write_text(json.dumps(sealed(record)))
    (board / "leaderboard/results/patients/board.json").unlink()
    words = ("audit", "nearest-pose", "--board", "patients", "--json")
    (report,) = json.loads(racines(*words, code=1))["reports"]
    assert report["verdict"] == "does not hold"
    wrong = {each["subject"] for each in report["verdicts"] if each["verdict"] == "does not hold"}
    assert wrong >= set(told.split(", "))


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("eval", "generator", "nearest-pose", "--tier", "beating"), "know no phase of the beat"),
        (("eval", "generator", "nearest-pose", "--tier", "nobody"), "unknown tier"),
        (("eval", "generator", "mine.onnx", "--tier", "patients"), "cannot adapt to a patient"),
        (("eval", "generator", "nearest-pose", "--patients", "3"), "needs --tier patients"),
        (("eval", "generator", "flow", "--tier", "patients"), "no trained flow here"),
        (("eval", "generator", "nearest-pose", "--tier", "patients", "--patients", "2000"),
         "has 1 to 1000"),
    ],
)  # fmt: skip
def test_what_cannot_be_scored_is_refused(board, words, message):
    done = CliRunner().invoke(app, list(words))
    assert done.exit_code != 0 and message in str(done.exception or done.output)


def test_a_scout_that_is_too_short_is_refused(board):
    asked = AskedStore("validation", 2, 0, Path("models/runs/scores/reference"))
    (generator,) = open_for_patients(
        "scout-attention", Path("models/runs/patients/scout-attention")
    )
    asked.scouts, asked.scout_parameters = (
        part[:, :7] for part in (asked.scouts, asked.scout_parameters)
    )
    with pytest.raises(RacinesError, match="has 7 frames and adapt needs 8"):
        draw_patients(generator, asked, 0)


def exported(*words: str) -> Path:
    """Return the file that `racines export WORDS --tier patients` writes."""
    out = Path("drawn") / f"{len(list(Path('drawn').glob('*')))}.parquet"
    racines("export", *words, "--out", str(out), "--tier", "patients")
    return out


def test_poses_and_scouts_are_all_that_a_program_outside_needs(board):
    poses = pq.read_table(exported("poses"))
    scouts = pq.read_table(Path("drawn/0-scouts.parquet"))
    asked = AskedStore("validation", 2, 0, Path("models/runs/scores/reference"))
    assert poses["sample"].to_pylist() == list(range(2 * POSES))
    for table, length in ((poses, POSES), (scouts, FRAMES)):
        whose = [patient for patient in asked.patients or () for _ in range(length)]
        assert table["patient"].to_pylist() == whose
        assert table.schema.metadata[b"racines.dataset"].decode() == asked.digest
    assert torch.equal(torch.tensor(poses["position_x"].to_pylist()), asked.parameters[:, 6])
    first = asked.scout_parameters[1, 0]
    assert scouts["rotation_z"][FRAMES].as_py() == float(first[11])
    assert scouts["image"][FRAMES].as_py() == encode_png(asked.scouts[1, 0].numpy())
    # Retrieval by a program of its own: whoever has both files can adapt.
    again = exported("predictions", "nearest-pose")
    told = pq.read_table(again)
    assert told["sample"].to_pylist() == poses["sample"].to_pylist()
    own = {scouts["image"][row].as_py() for row in range(FRAMES)}
    assert all(told["image"][row].as_py() in own for row in range(POSES))


@pytest.mark.parametrize(
    "name",
    ["scout-attention", *(pytest.param(name, marks=pytest.mark.thorough) for name in NAMES[:3])],
)
def test_images_drawn_elsewhere_are_scored_as_their_generator_is(board, name):
    by_name, _ = read_scores(SCORES / f"{name}.json")
    path = exported("predictions", name)
    racines("eval", "generator", str(path), "--tier", "patients", "--out", "elsewhere")
    scores, track = read_scores(Path(f"elsewhere/{name}.json"))
    assert track.name == PATIENT_GENERATORS.name and "adapts" not in scores
    metrics = dict(by_name["metrics"])
    metrics.pop("seconds_to_adapt", None)
    assert scores["metrics"] == metrics and scores["by_stratum"] == by_name["by_stratum"]
    assert scores["weights"] == {path.name: hashlib.sha256(path.read_bytes()).hexdigest()}


def handed_in(paths: list[Path], **changes) -> Path:
    """Hand images of patients in, one file a training; return the folder of the submission."""
    folder = Path("mine")
    folder.mkdir()
    artefacts = []
    for path in paths:
        content = path.read_bytes()
        (folder / path.name).write_bytes(content)
        sha256 = hashlib.sha256(content).hexdigest()
        entry = {"kind": "predictions", "path": path.name, "sha256": sha256, "size": len(content)}
        artefacts.append(entry)
    told = pq.read_schema(paths[0]).metadata
    digest, version = (told[b"racines." + key].decode() for key in (b"dataset", b"version"))
    document = {
        "schema": "racines.submission/2", "name": "mine", "track": PATIENT_GENERATORS.name,
        "authors": ["Somebody"], "method": "retrieval", "description": "Nearest frames.",
        "licence": "Apache-2.0", "tier": "recomputed",
        "dataset": {"source": "phantom", "version": version, "digest": digest}, "seeds": [0],
        "code": {"url": "https://example.org/mine", "commit": "0a1b2c3"},
        "training": {"budget": "none", "hardware": "a core"}, "artefacts": artefacts,
    }  # fmt: skip
    (folder / "submission.yaml").write_text(yaml.safe_dump(document | changes))
    return folder


@pytest.mark.thorough
def test_trainings_handed_in_are_ranked(board):
    drawers = NAMES[1:]
    folder = handed_in([exported("predictions", name) for name in drawers])
    said = racines("submit", str(folder), "--recompute", "--params", "params.yaml")
    assert "sound (mine, patient-generators)" in said
    record = json.loads((RESULTS / "patients/patient-generators/mine.json").read_text())
    alone = [read_scores(SCORES / f"{name}.json")[0]["metrics"] for name in drawers]
    assert record["tier"] == "recomputed" and record["scores"]["runs"] == 3
    for key in ("ssim", "psnr", "kid", "dice", "pose_error_mm"):
        value = sum(each[key]["value"] for each in alone) / 3
        assert record["scores"]["metrics"][key]["value"] == pytest.approx(value, abs=1e-9)
    records = read_board(RESULTS, "patients")[PATIENT_GENERATORS.name]
    (mine,) = (each for each in rankings(PATIENT_GENERATORS, records)
               if each.record["name"] == "mine")  # fmt: skip
    assert mine.place == 1, "three trainings, and no bound"


def test_images_handed_in_are_scored_again_and_audited(board):
    folder = handed_in([exported("predictions", "nearest-pose")])
    racines("submit", str(folder), "--recompute", "--params", "params.yaml")
    record = json.loads((RESULTS / "patients/patient-generators/mine.json").read_text())
    alone = read_scores(SCORES / "nearest-pose.json")[0]["metrics"]
    assert record["tier"] == "recomputed" and record["scores"]["runs"] == 1
    for key in ("ssim", "psnr", "kid", "dice", "pose_error_mm"):
        assert record["scores"]["metrics"][key] == alone[key]
    (report,) = json.loads(racines("audit", "mine", "--board", "patients", "--json"))["reports"]
    assert report["verdict"] == "holds", report
    again = ("leaderboard", "--recompute", "mine", "--params", "params.yaml", "--board", "mini")
    done = CliRunner().invoke(app, list(again))
    assert "differs from 'patients'" in str(done.exception)
    secret = Secret("patients", 1, hashlib.sha256(b"a nonce").digest())
    commit(RESULTS, "patients", secret.nonce, "2026-11-26", Path("nonce.json"))
    ground = recompute.Ground("patients", SETTINGS, cache=Path("models/runs/scores/reference"))
    place = Path("leaderboard/submissions/patient-generators/mine")
    with pytest.raises(RacinesError, match="is drawn in secret: images are no program"):
        draw_in_secret(place, ground, RESULTS, secret, "2026-11-26")


def test_images_of_others_are_refused(board):
    path = exported("predictions", "nearest-pose", "--patients", "1")
    folder = handed_in([path])
    words = ("submit", str(folder), "--recompute", "--params", "params.yaml")
    done = CliRunner().invoke(app, list(words))
    assert "mine: dataset.digest" in str(done.exception)
    assert "what board patients asks of patients" in str(done.exception)
    Path("params.yaml").write_text(
        yaml.safe_dump(SETTINGS | {"patient_boards": []}), encoding="utf-8"
    )
    done = CliRunner().invoke(app, ["leaderboard", "--recompute", "mine"])
    assert "which these settings do not make (patient_boards: none)" in str(done.exception)
    for words, message in (
        (("export", "poses", "--patients", "2", "--out", "a.parquet"), "needs --tier patients"),
        (("export", "poses", "--tier", "patients", "--samples", "9", "--out", "a.parquet"),
         "--samples is not for --tier patients"),
        (("export", "predictions", "a.onnx", "--tier", "patients", "--out", "a.parquet"),
         "cannot adapt to a patient"),
        (("eval", "generator", str(path), "--tier", "patients"), "this one is"),
    ):  # fmt: skip
        done = CliRunner().invoke(app, list(words))
        assert done.exit_code != 0 and message in str(done.exception), words
