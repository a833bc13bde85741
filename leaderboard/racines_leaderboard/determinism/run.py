"""Running the stages in every way, and comparing what comes out."""

import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import torch

from racines_data.errors import RacinesError
from racines_data.files import write_json
from racines_data.tables import escape, markdown_table
from racines_leaderboard.determinism.processes import (
    ATEN,
    LEVELS,
    ONEDNN,
    Processes,
    own_level,
)
from racines_leaderboard.determinism.stages import Arrays, Setup, Stage, Work, stages, threads
from racines_models.provenance import code_version, environment

SCHEMA = "racines.determinism/2"
FIRST = Setup()
OWN = "the machine's own choice"


@dataclass(frozen=True)
class Variant:
    """One way to run a stage again, beside the first."""

    compared: str
    """The column that it has in the table."""
    setup: Setup = FIRST
    variables: Mapping[str, str] | None = None
    """Environment of a process of its own; None: in this process."""


VARIANTS: dict[str, Variant] = {
    "again": Variant("twice"),
    "process": Variant("two processes", variables={}),
    "threads": Variant("1 and 2 threads", Setup(threads=2)),
    "batch": Variant("batch 64 and 1", Setup(batch=1)),
    "workers": Variant("1 and 2 workers", Setup(workers=2)),
    "onnx": Variant("PyTorch and ONNX", Setup(device="onnx")),
    "cuda": Variant("CPU and CUDA", Setup(device="cuda")),
    "aten-default": Variant("ATen default", variables={ATEN: "default"}),
    "aten-avx2": Variant("ATen AVX2", variables={ATEN: "avx2"}),
    "aten-avx512": Variant("ATen AVX-512", variables={ATEN: "avx512"}),
    "onednn-avx2": Variant("oneDNN AVX2", variables={ONEDNN: "AVX2"}),
    "onednn-avx512": Variant("oneDNN AVX-512", variables={ONEDNN: "AVX512_CORE"}),
}
"""What is compared with the first run, which has one thread, batch 64, the CPU, and the
instructions that the libraries choose by themselves."""
REPEATS = ("twice", "two processes")
"""Ways in which every stage has to give the same bytes."""


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
    measured = {each.stage for each in outcomes}
    with TemporaryDirectory() as folder, Processes(Path(folder)) as processes:
        work = Work(Path(folder))
        for stage in (each for each in chosen if each.name not in measured):
            made = compare_stage(stage, work, processes)
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
        before, here = json.loads(out.read_text(encoding="utf-8")), _document([], 0.0)
        if any(before[key] != here[key] for key in ("schema", "code", "environment")):
            return [], 0.0
        return [Outcome(**each) for each in before["outcomes"]], before["seconds"]
    except (ValueError, KeyError, TypeError):
        return [], 0.0  # another file, or of another version: measured again


def compare_stage(stage: Stage, work: Work, processes: Processes) -> list[Outcome]:
    """Run a stage in each of its ways; a way that is not to be had here is told with the reason."""
    first: Arrays | None = None
    outcomes = []
    for name in stage.compared:
        variant = VARIANTS[name]
        began = time.perf_counter()
        try:
            _refuse_absent(variant)
            first = _run(stage, work, FIRST) if first is None else first
            if variant.variables is None:
                second = _run(stage, work, variant.setup)
            else:
                second = processes.run(stage, variant.setup, variant.variables)
        except RacinesError as error:
            found, seconds, note = (None, None, None), 0.0, str(error)
        else:
            seconds, note = round(time.perf_counter() - began, 2), ""
            found = differences(first, second)
        outcomes.append(Outcome(stage.name, variant.compared, *found, stage.unit, seconds, note))
    return outcomes


def _refuse_absent(variant: Variant) -> None:
    """Refuse a way that this machine does not have, or that is the first way itself."""
    if variant.setup.device == "cuda" and not torch.cuda.is_available():
        raise RacinesError("no CUDA device here")
    told = "".join((variant.variables or {}).values()).partition("_")[0].upper()
    if LEVELS.get(told, 0) > own_level():
        raise RacinesError(f"this CPU has no {told}")
    if variant.variables and ATEN in variant.variables and LEVELS[told] == own_level():
        raise RacinesError(OWN)  # oneDNN's levels are finer: its AVX512_CORE may be another's


def _run(stage: Stage, work: Work, setup: Setup) -> Arrays:
    with threads(setup.threads):
        return {key: value.clone() for key, value in stage.make(work, setup).items()}


def unrepeated(document: dict[str, Any]) -> list[str]:
    """Return the stages that gave other bytes a second time, in this process or in another."""
    return [
        f"{each['stage']} ({each['compared']})"
        for each in document["outcomes"]
        if each["compared"] in REPEATS and not each["bitwise"]
    ]


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
        return "own" if outcome["note"] == OWN else "–"
    if outcome["bitwise"]:
        return "bitwise"
    return f"{outcome['largest']:.2g} {outcome['unit']} ({100 * outcome['share']:.2g} % differ)"
