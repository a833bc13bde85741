"""What scores rest on: the dataset and the judges, or the phantom and its task; and the seeds."""

import json
from dataclasses import asdict
from types import SimpleNamespace
from typing import Any

from racines_data.config import fill, section
from racines_data.errors import RacinesError
from racines_leaderboard.audit.bench import JUDGES, KINDS, Bench
from racines_leaderboard.audit.verdicts import UNKNOWN, Verdict, equal, fails, holds, unknown
from racines_leaderboard.board.collect import Record


def dataset(record: Record, bench: Bench) -> list[Verdict]:
    """Check source, version, digests and sample of the dataset that a generator was scored on."""
    claimed, verdicts = record["scores"]["dataset"], []
    recipe = claimed["recipe_digest"]
    if bench.recipe is None:
        reason = f"no settings of board {bench.board} here that name a recipe: give --params"
        verdicts.append(unknown("dataset.recipe_digest", reason, recipe))
    else:
        reason = "the recipe that the board's settings build"
        verdicts.append(equal("dataset.recipe_digest", recipe, bench.recipe, reason))
    verdicts.append(equal("dataset.split", claimed["split"], bench.scores.split, "scores.split"))
    store, where = bench.data_for(recipe), bench.places.data
    if store is None:
        reason = f"no dataset of that recipe in {where}"
        keys = ("source", "version", "digest", "sample")
        return verdicts + [
            unknown(f"dataset.{key}", reason, claimed[key]) for key in keys if key in claimed
        ]
    here = store.manifest
    reason = f"the manifest of {where}"
    for key in ("source", "version"):
        verdicts.append(equal(f"dataset.{key}", claimed[key], here[key], reason))
    if claimed["digest"] == here["digest"]:
        verdicts.append(holds("dataset.digest", reason, claimed["digest"], here["digest"]))
    else:
        built = "the same recipe, built elsewhere: a few pixels differ"
        verdicts.append(unknown("dataset.digest", built, claimed["digest"], here["digest"]))
    if "sample" in claimed:
        reason = f"digest of the rows of {bench.scores.samples:,} frames at most"
        verdicts.append(equal("dataset.sample", claimed["sample"], bench.sample.digest, reason))
    return verdicts


def judges(record: Record, bench: Bench, peers: list[Record]) -> list[Verdict]:
    """Check that the extractors are the benchmark's own; where they are not here, the board's."""
    verdicts = []
    for kind, claimed in record["scores"].get("extractors", {}).items():
        subject, sha256 = f"extractors.{kind}", claimed.get("sha256")
        if kind == "inception":
            reason = "weights, layer, resizer and range here"
            verdicts.append(equal(subject, claimed, bench.inception, reason))
            continue
        verdict = unknown(subject, "an extractor unknown to this code", sha256)
        if kind in KINDS:
            verdict = _judge(subject, KINDS[kind], sha256, record, bench)
        if verdict.verdict == UNKNOWN:
            others = [peer["scores"].get("extractors", {}).get(kind) for peer in peers]
            verdict = _of_board(verdict, claimed, others)
        verdicts.append(verdict)
    return verdicts


def _of_board(
    verdict: Verdict, claimed: dict[str, Any], others: list[dict[str, Any] | None]
) -> Verdict:
    """Return the verdict on a judge that is not here by those of two or more other rows."""
    named = [other for other in others if other is not None]
    strangers = [other for other in named if other != claimed]
    if len(named) < 2 or 2 * len(strangers) <= len(named):
        return verdict
    reason = "most rows of the board were judged by another"
    return fails(verdict.subject, reason, verdict.claimed, strangers[0].get("sha256"))


def _judge(subject: str, kind: str, sha256: str | None, record: Record, bench: Bench) -> Verdict:
    from racines_data.files import sha256_file

    if folder := bench.judge(kind, sha256):
        return holds(subject, f"the weights in {folder}", sha256, sha256)
    own = (record["scores"].get("dataset") or {}).get("recipe_digest")
    for folder in bench.judge_folders(kind):
        if own is not None and _trained_on(folder).get("recipe_digest") == own:
            here = sha256_file(folder / JUDGES[kind])
            return fails(subject, f"{folder}, trained on these data, is another", sha256, here)
    return unknown(subject, f"no {kind} with these weights here", sha256)


def _trained_on(folder: Any) -> dict[str, Any]:
    try:
        return json.loads((folder / "config.json").read_text()).get("dataset") or {}
    except (OSError, ValueError):
        return {}


def drawing_seeds(record: Record, bench: Bench) -> list[Verdict]:
    """Check the seeds that images were drawn with against the board's settings."""
    if bench.settings is None:
        return [unknown("seeds", f"no settings of board {bench.board} here: give --params")]
    from racines_models.scores.scoring import take_turns

    claimed, runs = record["scores"]["seeds"], record["scores"].get("runs", 1)
    allowed = []
    for stochastic in (True, False):  # what draws the same whatever the seed draws once a run
        stand_in: Any = SimpleNamespace(card=SimpleNamespace(stochastic=stochastic))
        turns = take_turns([stand_in] * runs, bench.scores.seeds)
        allowed.append([seed for _, seed in turns])
    reason = "scores.seeds of the board's settings; without noise the first alone"
    verdict = holds if claimed in allowed else fails
    return [verdict("seeds", reason, claimed, allowed[0])]


def task(record: Record, bench: Bench) -> list[Verdict]:
    """Check phantom, task, reward, backend and starts of an agent's scores."""
    if bench.settings is None:
        return [unknown("task", f"no settings of board {bench.board} here: give --params")]
    from racines_envs.cli.settings import phantom_config
    from racines_envs.evaluation.run import EvaluationConfig
    from racines_envs.worlds.making import find_task, phantom_recipe

    scores, claimed = record["scores"], record["scores"]["task"]
    config = fill(EvaluationConfig, section(bench.settings, "evaluation"), "evaluation")
    phantom = phantom_config(bench.settings)
    verdicts = []
    here = phantom_recipe(phantom) or {}
    for key, value in (scores.get("phantom") or {}).items():
        reason = "the phantom of the board's settings"
        verdicts.append(equal(f"phantom.{key}", value, here.get(key), reason))
    try:
        defined = json.loads(json.dumps(asdict(find_task(claimed["view"], phantom))))
    except RacinesError as error:
        return [*verdicts, fails("task.view", str(error), claimed["view"])]
    if "definition" in claimed:
        same = equal("task.definition", claimed["definition"], defined, "the task as it is here")
        verdicts.append(same)
    for key in ("backend", "reward"):
        reason = f"evaluation.{key} of the board's settings"
        verdicts.append(equal(f"task.{key}", claimed[key], getattr(config, key), reason))
    starts = {"seeds": list(config.sets), "starts": config.starts}
    reason = "the start sets of the board's settings"
    verdicts.append(equal("task.start_set", claimed["start_set"], starts, reason))
    verdicts.append(equal("seeds", scores["seeds"], list(config.sets), reason))
    return verdicts
