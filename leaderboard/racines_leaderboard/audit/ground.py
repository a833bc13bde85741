"""What scores rest on: the dataset and the judges, or the phantom and its task; and the seeds."""

import json
from collections.abc import Iterator
from dataclasses import asdict
from types import SimpleNamespace
from typing import Any

from racines_data.errors import RacinesError
from racines_data.files import sha256_file
from racines_leaderboard.audit.bench import JUDGES, KINDS, Bench
from racines_leaderboard.audit.verdicts import UNKNOWN, Verdict, equal, fails, holds, tell, unknown
from racines_leaderboard.audit.weights import data_of
from racines_leaderboard.board.collect import Record


def dataset(record: Record, bench: Bench) -> Iterator[Verdict]:
    """Check source, version, digests and sample of the dataset that a generator was scored on."""
    claimed = record["scores"]["dataset"]
    recipe = claimed["recipe_digest"]
    if bench.recipe is None:
        reason = f"no settings of board {bench.board} here that name a recipe: give --params"
        yield unknown("dataset.recipe_digest", reason, recipe)
    else:
        reason = "the recipe that the board's settings build"
        yield equal("dataset.recipe_digest", recipe, bench.recipe, reason)
    yield equal("dataset.split", claimed["split"], bench.scores.split, "scores.split")
    store = bench.data_for(recipe)
    if store is None:
        reason = f"no dataset of that recipe in {bench.places.data}"
        keys = [key for key in ("source", "version", "digest", "sample") if key in claimed]
        yield from (unknown(f"dataset.{key}", reason, claimed[key]) for key in keys)
        return
    here, reason = store.manifest, f"the manifest of {bench.places.data}"
    for key in ("source", "version"):
        yield equal(f"dataset.{key}", claimed[key], here[key], reason)
    built = "the same recipe, built elsewhere: a few pixels differ"
    same = claimed["digest"] == here["digest"]
    say, reason = (holds, reason) if same else (unknown, built)
    yield say("dataset.digest", reason, claimed["digest"], here["digest"])
    if "sample" in claimed:
        reason = f"digest of the rows of {bench.scores.samples:,} frames at most"
        yield equal("dataset.sample", claimed["sample"], bench.sample.digest, reason)


def judges(record: Record, bench: Bench, peers: list[Record]) -> Iterator[Verdict]:
    """Check that the extractors are the benchmark's own; where they are not here, the board's."""
    for kind, claimed in record["scores"].get("extractors", {}).items():
        if kind == "inception":
            reason = "weights, layer, resizer and range here"
            yield equal(f"extractors.{kind}", claimed, bench.inception, reason)
            continue
        verdict = _judge(kind, claimed.get("sha256"), record, bench)
        others = [peer["scores"].get("extractors", {}).get(kind) for peer in peers]
        named = [other for other in others if other is not None]
        strangers = [other for other in named if other != claimed]
        if verdict.verdict == UNKNOWN and len(named) >= 2 and 2 * len(strangers) > len(named):
            reason, theirs = "most rows of the board were judged by another", strangers[0]
            verdict = fails(verdict.subject, reason, verdict.claimed, theirs.get("sha256"))
        yield verdict


def _judge(kind: str, sha256: str | None, record: Record, bench: Bench) -> Verdict:
    subject = f"extractors.{kind}"
    if kind not in KINDS:
        return unknown(subject, "an extractor unknown to this code", sha256)
    judge = KINDS[kind]
    if folder := bench.judge(judge, sha256):
        return holds(subject, f"the weights in {folder}", sha256, sha256)
    own = (record["scores"].get("dataset") or {}).get("recipe_digest")
    for folder in bench.judge_folders(judge):
        if own is not None and data_of(folder) == own:
            here = sha256_file(folder / JUDGES[judge])
            return fails(subject, f"{folder}, trained on these data, is another", sha256, here)
    return unknown(subject, f"no {judge} with these weights here", sha256)


def drawing_seeds(record: Record, bench: Bench) -> Iterator[Verdict]:
    """Check the seeds that images were drawn with against the board's settings."""
    if bench.settings is None:
        yield unknown("seeds", bench.no_settings)
        return
    from racines_models.scores.scoring import take_turns

    claimed, runs = record["scores"]["seeds"], record["scores"].get("runs", 1)
    allowed = []
    for stochastic in (True, False):  # what draws the same whatever the seed draws once a run
        stand_in: Any = SimpleNamespace(card=SimpleNamespace(stochastic=stochastic))
        turns = take_turns([stand_in] * runs, bench.scores.seeds)
        allowed.append([seed for _, seed in turns])
    reason = "scores.seeds of the board's settings; without noise the first alone"
    yield tell(claimed in allowed, "seeds", reason, claimed, allowed[0])


def task(record: Record, bench: Bench) -> Iterator[Verdict]:
    """Check phantom, task, reward, backend and starts of an agent's scores."""
    if bench.settings is None:
        yield unknown("task", bench.no_settings)
        return
    from racines_envs.cli.settings import phantom_config
    from racines_envs.worlds.making import find_task, phantom_recipe

    scores, claimed, config = record["scores"], record["scores"]["task"], bench.evaluation
    phantom = phantom_config(bench.settings)
    here = phantom_recipe(phantom) or {}
    for key, value in (scores.get("phantom") or {}).items():
        yield equal(f"phantom.{key}", value, here.get(key), "the phantom of the board's settings")
    try:
        defined = json.loads(json.dumps(asdict(find_task(claimed["view"], phantom))))
    except RacinesError as error:
        yield fails("task.view", str(error), claimed["view"])
        return
    if "definition" in claimed:
        reason = "the task as it is here"
        yield equal("task.definition", claimed["definition"], defined, reason)
    for key in ("backend", "reward"):
        reason = f"evaluation.{key} of the board's settings"
        yield equal(f"task.{key}", claimed[key], getattr(config, key), reason)
    starts = {"seeds": list(config.sets), "starts": config.starts}
    reason = "the start sets of the board's settings"
    yield equal("task.start_set", claimed["start_set"], starts, reason)
    yield equal("seeds", scores["seeds"], starts["seeds"], reason)
