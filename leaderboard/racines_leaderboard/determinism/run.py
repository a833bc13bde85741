"""Running the stages in every way, and comparing what comes out."""

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import torch

from racines_data.errors import RacinesError
from racines_data.files import write_json
from racines_data.tables import escape, markdown_table
from racines_leaderboard.determinism.stages import Arrays, Setup, Stage, Work, stages, threads
from racines_models.provenance import code_version, environment

SCHEMA = "racines.determinism/1"
FIRST = Setup()
VARIANTS: dict[str, tuple[str, Setup]] = {
    "again": ("twice", FIRST),
    "threads": ("1 and 2 threads", Setup(threads=2)),
    "batch": ("batch 64 and 1", Setup(batch=1)),
    "workers": ("1 and 2 workers", Setup(workers=2)),
    "onnx": ("PyTorch and ONNX", Setup(device="onnx")),
    "cuda": ("CPU and CUDA", Setup(device="cuda")),
}
"""What is compared with the first run, which has one thread, batch 64 and the CPU."""


@dataclass(frozen=True)
class Outcome:
    """One stage in two ways."""

    stage: str
    compared: str
    bitwise: bool | None
    """None where the second way is not to be had; `note` says why."""
    largest: float | None
    """Largest absolute difference."""
    share: float | None
    """Of the numbers that differ."""
    unit: str
    seconds: float
    note: str = ""


def measure(
    names: Sequence[str] = (),
    tell: Callable[[Outcome], object] = lambda outcome: None,
    out: Path | None = None,
) -> dict[str, Any]:
    """Run all stages, or those whose names begin with one of `names`; return the report.

    `tell` is told of each outcome as it comes. `out`, a JSON file, is written as stages end; what
    it holds of this code and machine is kept, so that a killed run goes on.

    Raises:
        RacinesError: no stage of such a name.
    """
    chosen = [each for each in stages() if not names or each.name.startswith(tuple(names))]
    if not chosen:
        known = ", ".join(each.name for each in stages())
        raise RacinesError(f"no stage {', '.join(names)}: choose among {known}")
    outcomes, before = _kept(out)
    began = time.perf_counter()
    document = _document(outcomes, before)
    with TemporaryDirectory() as folder:
        work, measured = Work(Path(folder)), {each.stage for each in outcomes}
        for stage in (each for each in chosen if each.name not in measured):
            made = compare_stage(stage, work)
            outcomes += made
            document = _document(outcomes, before + time.perf_counter() - began)
            if out is not None:
                write_json(out, document)
            for outcome in made:
                tell(outcome)
    return document


def _kept(out: Path | None) -> tuple[list[Outcome], float]:
    """Return the outcomes that a former run of this code on this machine left, and its seconds."""
    if out is None or not out.is_file():
        return [], 0.0
    try:
        before, here = json.loads(out.read_text()), _document([], 0.0)
        if any(before[key] != here[key] for key in ("schema", "code", "environment")):
            return [], 0.0
        return [Outcome(**each) for each in before["outcomes"]], before["seconds"]
    except (ValueError, KeyError, TypeError):
        return [], 0.0  # another file, or of another version: measured again


def compare_stage(stage: Stage, work: Work) -> list[Outcome]:
    """Run a stage in each of its ways; a way that is not to be had here is told with the reason."""
    first: Arrays | None = None
    outcomes = []
    for name in stage.compared:
        compared, setup = VARIANTS[name]
        began = time.perf_counter()
        try:
            if setup.device == "cuda" and not torch.cuda.is_available():
                raise RacinesError("no CUDA device here")
            first = _run(stage, work, FIRST) if first is None else first
            second = _run(stage, work, setup)
        except RacinesError as error:
            found, seconds, note = (None, None, None), 0.0, str(error)
        else:
            seconds, note = round(time.perf_counter() - began, 2), ""
            found = differences(first, second)
        outcomes.append(Outcome(stage.name, compared, *found, stage.unit, seconds, note))
    return outcomes


def _run(stage: Stage, work: Work, setup: Setup) -> Arrays:
    with threads(setup.threads):
        return {key: value.clone() for key, value in stage.make(work, setup).items()}


def differences(first: Arrays, second: Arrays) -> tuple[bool, float, float]:
    """Return whether arrays are equal bit by bit, the largest difference, the share that differs.

    NaN in both is no difference, NaN in one an infinite one.

    Raises:
        ValueError: other names or shapes.
    """
    if {k: v.shape for k, v in first.items()} != {k: v.shape for k, v in second.items()}:
        raise ValueError("the two runs made arrays of other names or shapes")
    none = torch.zeros(0, dtype=torch.float64)
    a, b = (
        torch.cat([none, *(each[key].double().flatten() for key in first)])
        for each in (first, second)
    )
    same = (a == b) | (a.isnan() & b.isnan())  # two infinities are equal
    gap = (a - b).abs().nan_to_num(nan=torch.inf, posinf=torch.inf).masked_fill(same, 0.0)
    differing = int((gap > 0).sum())
    return differing == 0, float(gap.max()) if len(gap) else 0.0, differing / max(len(gap), 1)


def _document(outcomes: list[Outcome], seconds: float) -> dict[str, Any]:
    return {
        "schema": SCHEMA,
        "seconds": round(seconds, 1),
        "code": code_version(),
        "environment": environment("cuda" if torch.cuda.is_available() else "cpu"),
        "outcomes": [asdict(each) for each in outcomes],
    }


def determinism_markdown(document: dict[str, Any]) -> str:
    """Return a report as Markdown: a row a stage, a column a way."""
    ways = list(dict.fromkeys(each["compared"] for each in document["outcomes"]))
    rows: dict[str, dict[str, str]] = {}
    for each in document["outcomes"]:
        rows.setdefault(each["stage"], {})[each["compared"]] = cell(each)
    here = document["environment"]
    table = markdown_table(
        ("stage", *ways),
        ((stage, *(cells.get(way, "") for way in ways)) for stage, cells in rows.items()),
    )
    about = f"torch {here['torch']}, {here['cpu']}, {here['platform']}"
    return "\n".join([table, "", f"{escape(about)}. {document['seconds']:.0f} s.", ""])


def cell(outcome: dict[str, Any]) -> str:
    """Return what a table says of an outcome."""
    if outcome["bitwise"] is None:
        return "–"
    if outcome["bitwise"]:
        return "bitwise"
    return f"{outcome['largest']:.2g} {outcome['unit']} ({100 * outcome['share']:.2g} % differ)"
