"""Records of a tiny board, each with all that an audit of it needs."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
import yaml
from typer.testing import CliRunner

from racines_data.files import sha256_file
from racines_data.store.frames import open_store
from racines_data.views import LABELS
from racines_envs.agents.onnx.policy import OnnxPolicyAgent
from racines_envs.evaluation.patients import PatientsConfig, evaluate_patients
from racines_envs.evaluation.run import (
    EvaluationConfig,
    evaluate,
    record_trace,
    write_evaluation,
)
from racines_envs.worlds.making import make_phantom, phantom_recipe
from racines_leaderboard.audit.bench import JUDGES
from racines_leaderboard.board.collect import collect
from racines_leaderboard.board.recompute import Ground, recompute
from racines_leaderboard.cli.command import app
from racines_models.exchange.onnx.generator import OnnxGenerator
from racines_models.exchange.predictions.file import Task, write_predictions
from racines_models.generators.mean_image import MeanImage
from racines_models.judges.grader.model import Grader, GraderConfig
from racines_models.judges.pose.regressor import PoseConfig, PoseNetwork, PoseRegressor
from racines_models.protocol import Run
from racines_models.registry import weights_of
from racines_models.sample import take_sample
from racines_models.scores.scoring import score
from tests.conftest import Once, lay_workplace
from tests.leaderboard.conftest import lay_ground, write_submission
from tests.leaderboard.graphs import sound_generator, sound_policy
from tests.leaderboard.handed_in import CONFIG, inbox, submitted

RESULTS, SUBMISSIONS = Path("leaderboard/results"), Path("leaderboard/submissions")
Make = Callable[[Ground], Path]
WHERE = "record.txt"
"""Says where the record lies that was made in a folder."""


@pytest.fixture(scope="session")
def once(tiny_root: Path, made_once: Once) -> Callable[[Make], tuple[Path, Path]]:
    """Make each record once, in a folder of its own; give the folder and the record in it."""

    def of(make: Make) -> tuple[Path, Path]:
        def lay(folder: Path) -> None:
            lay_workplace(folder, tiny_root)
            with pytest.MonkeyPatch.context() as patch:
                path = make(lay_ground(folder, patch))
            (folder / WHERE).write_text(str(path), encoding="utf-8")

        folder = made_once(f"audited-{make.__name__}", lay)
        return folder, Path((folder / WHERE).read_text(encoding="utf-8"))

    return of


def copied(make: Make) -> Any:
    """Return the fixture of a record: what was made once, copied to where the test works."""

    def fixture(once, ground) -> Path:
        folder, path = once(make)

        def here_already(inside: str, names: list[str]) -> set[str]:
            return {"data", "racines", WHERE} if inside == str(folder) else set()

        shutil.copytree(folder, Path.cwd(), ignore=here_already, dirs_exist_ok=True)
        return path

    return pytest.fixture(fixture, name=make.__name__)


@copied
def drawn(ground: Ground) -> Path:
    """The record of a predictions file that was handed in and scored."""
    store, root = open_store(ground.data), Path.cwd()
    generator = OnnxGenerator(sound_generator(inbox(root, "made") / "mine.onnx"))
    path = inbox(root, "in") / "drawn.parquet"
    task = Task(store, take_sample(store, "test", 16), "test", (0,))
    write_predictions(path, task, generator, "stripes")
    folder = submitted(root, "predictions", path, store.manifest["digest"])
    recompute(folder, ground, RESULTS)
    return RESULTS / "tiny/generators/mine.json"


@copied
def steered(ground) -> Path:
    """The record of a trace that was handed in and scored."""
    trace = record_a_trace((0, 1, 2), inbox(Path.cwd(), "steered") / "trace.json")
    recipe: Any = phantom_recipe(make_phantom(None))
    folder = submitted(Path.cwd(), "trace", trace, recipe["recipe_digest"])
    recompute(folder, ground, RESULTS)
    return RESULTS / "tiny/agents/mine.json"


@copied
def merged(ground) -> Path:
    """The record of merged code, collected from the scores of its run."""
    store, runs = open_store(ground.data), Path("models/runs")
    generator = MeanImage()
    generator.fit(store, Run(runs / "mean-image", progress=False))
    scores = score(generator, store, CONFIG, "mean-image").content
    scores |= {"weights": weights_of("mean-image", runs / "mean-image")}
    scores["dataset"]["board"] = "tiny"
    (runs / "scores").mkdir()
    (runs / "scores/mean-image.json").write_text(json.dumps(scores))
    (path,) = collect([runs / "scores"], RESULTS, SUBMISSIONS, "tiny")
    return path


@copied
def climbed(ground) -> Path:
    """The record of an agent that goes by the grader which judges its last images."""
    evaluate_at_one_start_set(2)
    folder = a_grader(Path("models/runs/grader"))
    return climb(EvaluationConfig(starts=2, seeds=(0,), grader=str(folder), latency=0))


@copied
def scanned(ground) -> Path:
    """The record of a planner on patients, who have a board of their own."""
    settings = yaml.safe_load(Path("params.yaml").read_text(encoding="utf-8")) | {
        "patient_boards": ["patients"]
    }
    settings["evaluation_patients"] = {"split": "validation", "patients": 3, "starts": 1}
    Path("params.yaml").write_text(yaml.safe_dump(settings), encoding="utf-8")
    config = PatientsConfig(split="validation", patients=3, starts=1)
    run = "planner-a4c"
    scored = evaluate_patients("planner", Path("envs/runs/planner"), config, None, run, "patients")
    write_evaluation(scored, Path(f"envs/runs/patients/{run}.json"), None)
    (path,) = collect([Path("envs/runs/patients")], RESULTS, SUBMISSIONS, "patients")
    return path


def evaluate_at_one_start_set(starts: int) -> None:
    """Set the board to one start set."""
    settings = yaml.safe_load(Path("params.yaml").read_text(encoding="utf-8"))
    settings["evaluation"] = {"seeds": [0], "starts": starts}
    Path("params.yaml").write_text(yaml.safe_dump(settings), encoding="utf-8")


def climb(config: EvaluationConfig) -> Path:
    """Leave the record of a hill-climber that goes by the grader of its evaluation."""
    run = Path("envs/runs/hill-climber")
    scores = evaluate("hill-climber", run, config, board="tiny").scores
    Path("envs/runs/scores").mkdir(parents=True)
    Path("envs/runs/scores/hill-climber.json").write_text(json.dumps(scores), encoding="utf-8")
    (path,) = collect([Path("envs/runs/scores")], RESULTS, SUBMISSIONS, "tiny")
    return path


def record_a_trace(seeds: tuple[int, ...], path: Path) -> Path:
    agent = OnnxPolicyAgent(sound_policy(path.with_name("policy.onnx")))
    config = EvaluationConfig(starts=4, seeds=seeds, latency=0)
    record_trace("", Path.cwd(), config, path, make_phantom(None), agent=agent)
    path.with_name("policy.onnx").unlink()
    return path


@copied
def handed_in(ground) -> Path:
    """The record of an ONNX generator that was handed in and scored."""
    store, root = open_store(ground.data), Path.cwd()
    path = sound_generator(inbox(root, "in") / "mine.onnx")
    folder = submitted(root, "generator", path, store.manifest["digest"])
    recompute(folder, ground, RESULTS)
    return RESULTS / "tiny/generators/mine.json"


def a_grader(folder: Path) -> Path:
    """Leave an untrained grader in a folder."""
    torch.manual_seed(0)
    settings = GraderConfig(input_size=32, width=0.125)
    folder.mkdir(parents=True)
    Grader(Grader.build(settings, len(LABELS)), settings).save(folder)
    return folder


def a_pose_regressor(folder: Path) -> Path:
    """Leave an untrained pose regressor in a folder."""
    torch.manual_seed(0)
    PoseRegressor(PoseNetwork(64, 0.125), PoseConfig(width=0.125)).save(folder)
    return folder


def pin(track: str, **judges: Path) -> None:
    """Write which judges the board is pinned to."""
    hashes = {kind: sha256_file(folder / JUDGES[kind]) for kind, folder in judges.items()}
    pinned = {"schema": "racines.board/1", "board": "tiny", track: {"judges": hashes}}
    (RESULTS / "tiny/board.json").write_text(json.dumps(pinned))


@copied
def judged(ground) -> Path:
    """The record of merged code on a board that is pinned to a pose regressor."""
    store, runs = open_store(ground.data), Path("models/runs")
    generator = MeanImage()
    generator.fit(store, Run(runs / "mean-image", progress=False))
    pose = PoseRegressor.load(a_pose_regressor(runs / "pose"), "cpu")
    scores = score(generator, store, CONFIG, "mean-image", pose=pose).content
    scores |= {"weights": weights_of("mean-image", runs / "mean-image")}
    scores["dataset"]["board"] = "tiny"
    inbox(Path.cwd(), "scored")
    Path("scored/mean-image.json").write_text(json.dumps(scores), encoding="utf-8")
    adapter = {"kind": "adapter", "adapter": "racines_models.generators.mean_image:MeanImage"}
    data = {"source": "phantom", "version": "1.0.0", "digest": store.manifest["digest"]}
    about = {"name": "mean-image", "dataset": data, "url": "https://example.org/mean"}
    write_submission(SUBMISSIONS / "generators/mean-image", adapter, **about)
    (path,) = collect([Path("scored")], RESULTS, SUBMISSIONS, "tiny")
    pin("generators", pose=runs / "pose")
    return path


@copied
def guided(ground) -> Path:
    """The record of an agent on a board of one start set that is pinned to its grader."""
    evaluate_at_one_start_set(2)
    grader = a_grader(Path("models/runs/grader"))
    path = climb(EvaluationConfig(starts=2, seeds=(0,), grader=str(grader), latency=0))
    pin("agents", grader=grader)
    Path("envs/runs/scores/hill-climber.json").unlink()
    return path


@copied
def learned(ground) -> Path:
    """The record of an agent of three trainings, of which the first alone was published."""
    settings = yaml.safe_load(Path("params.yaml").read_text(encoding="utf-8"))
    entry = {"frames": 128, "envs": 8, "update_every": 128, "minibatch": 64, "epochs": 1}
    entry |= {"hidden": [8, 8], "validation_starts": 2, "repeats": 3}
    settings |= {"agents": {"ppo": entry}, "evaluation": {"seeds": [0, 1], "starts": 4}}
    Path("params.yaml").write_text(yaml.safe_dump(settings), encoding="utf-8")
    run, scored = Path("envs/runs/ppo"), inbox(Path.cwd(), "scored")
    recipe: Any = phantom_recipe(make_phantom(None))
    adapter = {"kind": "adapter", "adapter": "racines_envs.agents.ppo:PPOAgent"}
    data = {"source": "phantom", "version": "1.0.0", "digest": recipe["recipe_digest"]}
    about = {"name": "ppo", "track": "agents", "dataset": data}
    write_submission(SUBMISSIONS / "agents/ppo", adapter, **about)
    for words in (
        ("train", "agent", "ppo"),
        ("eval", "agent", "ppo", "--out", str(scored)),
        ("leaderboard", "--board", "tiny", "--collect", str(scored)),
    ):
        run_command(*words)
    published = inbox(Path.cwd() / "envs", "weights") / "ppo"
    published.mkdir()
    for file in ("config.json", "metrics.json", "policy.safetensors"):
        shutil.move(run / file, published / file)
    shutil.rmtree(run)
    return RESULTS / "tiny/agents/ppo.json"


def run_command(*words: str) -> None:
    done = CliRunner().invoke(app, list(words))
    assert done.exit_code == 0, done.output


@copied
def painted(ground) -> Path:
    """The record of a generator of three trainings, of which a copy of the first was published."""
    settings = yaml.safe_load(Path("params.yaml").read_text(encoding="utf-8"))
    settings["generators"]["vae-gan"]["training"]["repeats"] = 3
    Path("params.yaml").write_text(yaml.safe_dump(settings), encoding="utf-8")
    runs, copy = Path("models/runs"), Path("models/weights/vae-gan")
    scored = inbox(Path.cwd(), "scored")
    adapter = {"kind": "adapter", "adapter": "racines_models.generators.vae_gan:VaeGan"}
    digest = open_store(ground.data).manifest["digest"]
    data = {"source": "phantom", "version": "1.0.0", "digest": digest}
    write_submission(SUBMISSIONS / "generators/vae-gan", adapter, name="vae-gan", dataset=data)
    run_command("train", "generator", "vae-gan")
    further = [shutil.move(runs / f"vae-gan/seed-{seed}", f"seed-{seed}") for seed in (1, 2)]
    run_command("export", "weights", str(runs / "vae-gan"), "--out", str(copy))
    shutil.rmtree(runs / "vae-gan")
    for each in further:
        shutil.move(each, copy / each)
    run_command(
        "eval", "generator", "vae-gan", "--no-grader", "--run", str(copy), "--out", str(scored)
    )
    for each in further:
        shutil.rmtree(copy / each)
    run_command("leaderboard", "--board", "tiny", "--collect", str(scored))
    return RESULTS / "tiny/generators/vae-gan.json"
