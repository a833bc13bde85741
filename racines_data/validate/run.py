"""Checking a built dataset: every byte, every row, and what the rows say together.

manifest ──> files, card, recipe
shards   ──> survey (each shard read once, in parallel) ──> rows, counts, content, splits,
             store, times, rate, labels, views, annotation, duplicates, oracle, leaks, paper,
             modes; of patients: phases, masks, measures, people, reference
"""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from rich.table import Table
from rich.text import Text

from racines_data.errors import RacinesError
from racines_data.manifest import (
    ADDED,
    STORES,
    added_configs,
    config_manifest,
    digest_version,
    manifest_labels,
    read_manifest,
)
from racines_data.sources.gate.bounds import manifest_bounds
from racines_data.store.frames import FrameStore
from racines_data.tables import console_table
from racines_data.terminal import console
from racines_data.validate import identity, leaks, meaning, patients
from racines_data.validate.survey import Survey, survey
from racines_data.views import PAPER_STATISTICS, ParameterStatistics


@dataclass(frozen=True)
class Check:
    """One property of a dataset, and whether it holds."""

    name: str
    ok: bool
    detail: str
    binding: bool = True  # whether the dataset is invalid without it; else it is told and no more


@dataclass(frozen=True)
class Validation:
    """What was checked, and the figures behind it."""

    manifest: dict[str, Any]
    checks: list[Check] = field(default_factory=list)
    statistics: dict[str, ParameterStatistics] = field(default_factory=dict)  # what was measured
    verdicts: dict[str, meaning.Verdict] = field(default_factory=dict)  # against the paper, if any
    figures: dict[str, Any] = field(default_factory=dict)  # views, copies, oracle, by config

    @property
    def ok(self) -> bool:
        """Whether every binding check holds."""
        return all(check.ok for check in self.checks if check.binding)

    def add(self, name: str, check: Callable[[], str], binding: bool = True) -> bool:
        """Run a check, which returns what it found or raises what is wrong."""
        try:
            self.checks.append(Check(name, True, check(), binding))
        except (RacinesError, pa.ArrowException, OSError, LookupError, ValueError) as error:
            reason = f"{error}" if isinstance(error, RacinesError) else f"{error!r}"
            self.checks.append(Check(name, False, reason, binding))
        return self.checks[-1].ok


def validate(
    root: Path, against: Path | None = None, workers: int = 1, progress: bool = False
) -> Validation:
    """Check a dataset, reading every byte of it; `against` should be the same version.

    A large dataset's images are decoded in `workers` processes.

    Raises:
        RacinesError: there is no dataset.
    """
    manifest = read_manifest(root)
    result = Validation(manifest)
    result.add("files", lambda: identity.rehash_files(root, manifest, workers))
    result.add("card", lambda: identity.check_card(root, manifest))
    result.add("recipe", lambda: identity.check_recipe(manifest))
    for config in STORES:
        if config in manifest["configs"]:
            _check_config(result, root, config, workers, progress)
    if against is not None:
        result.add("same version", lambda: identity.same_version(root, against))
    return result


def _check_config(
    result: Validation, root: Path, config: str, workers: int, progress: bool
) -> None:
    """Read the rows of a config once, and run all checks of them."""
    manifest = config_manifest(result.manifest, config)
    prefix = "" if config == "frames" else f"{config}, "
    surveys: list[Survey] = []

    def read() -> str:
        surveys.append(survey(root, manifest, config, workers, progress))
        said = f"{len(surveys[0])} frames with the columns, types and ranges of the schema"
        return surveys[0].unless_faulty("rows", said)

    result.add(f"{prefix}rows", read)
    if not surveys or not surveys[0].sweeps:
        return  # without rows there is nothing more to say of them
    found = surveys[0]
    stored = f"{len(found)} frames, equal to the shards"
    result.add(f"{prefix}counts", lambda: identity.check_counts(found, manifest))
    result.add(f"{prefix}content", lambda: identity.check_content(found, manifest))
    result.add(f"{prefix}splits", lambda: identity.check_splits(found, root, manifest))
    result.add(f"{prefix}store", lambda: found.unless_faulty("store", stored))
    _check_meaning(result, prefix, found)
    _check_leaks(result, prefix, root, found)
    if config in ADDED:
        _check_patients(result, prefix, root, found)
    if config == "frames":
        _check_paper(result, found.column("parameters"))


def _check_paper(result: Validation, parameters: np.ndarray) -> None:
    """Hold (N, 12) parameters of `frames` against the paper's table, where it is the measure."""
    manifest = result.manifest
    result.statistics.update(meaning.statistics_of(parameters))
    if meaning.has_paper(manifest):
        result.verdicts.update(meaning.verdicts_of(result.statistics))
        binding = meaning.must_meet_paper(manifest)
        result.add("paper's table", lambda: meaning.check_paper(result.verdicts), binding)
        result.add("rotation_x", lambda: meaning.check_modes(parameters), binding)


def _check_meaning(result: Validation, prefix: str, found: Survey) -> None:
    manifest = config_manifest(result.manifest, found.config)
    named, simulated = manifest_labels(manifest), _is_simulated(manifest)
    bounds = manifest_bounds(manifest)
    repeats = bounds.repeats
    # Single images have neither poses nor times, and not every recording has a clock.
    if manifest.get("poses", True) and bounds.clock:
        result.add(f"{prefix}times", lambda: identity.check_times(found, repeats))
        result.add(f"{prefix}rate", lambda: identity.check_rate(found), binding=simulated)
    result.add(f"{prefix}labels", lambda: meaning.check_labels(found, named))
    shares = meaning.view_shares(found, named)
    result.add(f"{prefix}views", lambda: meaning.check_views(shares), binding=False)
    result.add(f"{prefix}annotation", lambda: meaning.check_annotation(found, manifest, named))
    copies = identity.find_duplicates(found)
    result.add(f"{prefix}copies", lambda: identity.check_exact(copies))
    result.add(f"{prefix}near-copies", lambda: identity.check_near(copies), binding=simulated)
    figures: dict[str, Any] = {"views": shares, "duplicates": vars(copies)}
    if simulated:
        judged: list[Any] = []

        def oracle() -> str:
            again = patients.rejudge if found.config in ADDED else meaning.rejudge
            judged.append(again(found, manifest))
            return meaning.check_rejudged(judged[0])

        result.add(f"{prefix}oracle", oracle)
        if judged and not isinstance(judged[0], str):
            figures["oracle"] = vars(judged[0])
    result.figures[found.config] = figures


def _check_leaks(result: Validation, prefix: str, root: Path, found: Survey) -> None:
    """Hold each held-out trajectory against the splits before it, by the store's images."""

    def check() -> str:
        if found.faults["store"]:
            return "not told: the store is not whole"
        store = FrameStore(root, found.config)
        if found.config in ADDED:
            leaks.check_patients(*(FrameStore(root, name) for name in added_configs(manifest)))
        sweeps = leaks.find_leaks(store)
        result.figures[found.config]["leaks"] = leaks.leaks_json(sweeps)
        return leaks.check_leaks(sweeps)

    # The limits are of simulated sweeps.
    manifest = config_manifest(result.manifest, found.config)
    result.add(f"{prefix}leaks", check, binding=_is_simulated(manifest))


def _check_patients(result: Validation, prefix: str, root: Path, found: Survey) -> None:
    """Check what the frames of patients have besides, and hold them beside their reference."""
    manifest = config_manifest(result.manifest, found.config)
    checks = {
        "phases": lambda: patients.check_phases(found, found.config),
        "masks": lambda: patients.check_masks(found, manifest["mask_labels"]),
        "measures": lambda: patients.check_measures(FrameStore(root, found.config).measures()),
        "people": lambda: patients.check_people(found, FrameStore(root, found.config).measures()),
    }
    for name, check in checks.items():
        result.add(f"{prefix}{name}", check)
    statistics = meaning.statistics_of(found.column("parameters"))
    binding = patients.must_meet_reference(manifest)
    told = {name: vars(each) for name, each in statistics.items()}
    result.figures[found.config]["statistics"] = told
    result.add(f"{prefix}reference", lambda: patients.check_reference(statistics), binding)


def _is_simulated(manifest: dict[str, Any]) -> bool:
    return manifest["source"] in ("phantom", *ADDED)


def to_json(result: Validation) -> dict[str, Any]:
    """Return a validation as JSON, the paper's statistics and the verdict beside ours."""
    parameters = {}
    for name, value in result.statistics.items():
        parameters[name] = {**vars(value), "paper": None, "verdict": None}
        if verdict := result.verdicts.get(name):
            parameters[name]["paper"] = vars(PAPER_STATISTICS[name])
            parameters[name]["verdict"] = {**vars(verdict), "ok": not verdict.faults}
    keys = ("source", "version", "digest", "recipe_digest", "counts")
    return {
        "schema": "racines.validation/1",
        **{key: result.manifest[key] for key in keys},
        "digest_version": digest_version(result.manifest),
        "ok": result.ok,
        "checks": [dataclasses.asdict(check) for check in result.checks],
        "statistics": parameters,
        "figures": result.figures,
    }


def print_validation(result: Validation) -> None:
    """Print one line a check, and the parameters beside the paper's table, on stdout."""
    shown_on = console()
    for check in result.checks:
        broken = ("BROKEN", "red") if check.binding else ("note", "yellow")
        mark = ("ok", "green") if check.ok else broken
        line = Text.assemble(mark, f"  {check.name}: {check.detail}")
        shown_on.print(line, soft_wrap=True)
    if result.statistics:
        shown_on.print(_table(result))


def _table(result: Validation) -> Table:
    rows: list[list[str | Text]] = []
    for name, values in result.statistics.items():
        rows.append([name, *_numbers(values)])
        if name in result.verdicts:
            faults = result.verdicts[name].faults
            rows[-1].append(Text("; ".join(faults), "red") if faults else Text("holds", "green"))
            paper = ("  paper, real", *_numbers(PAPER_STATISTICS[name]))
            rows.append([Text(cell, "dim") for cell in paper])
    head = ["parameter", *(field.name for field in dataclasses.fields(ParameterStatistics))]
    return console_table([*head, "verdict"] if result.verdicts else head, rows)


def _numbers(values: ParameterStatistics) -> list[str]:
    return [f"{value:.4f}" for value in dataclasses.astuple(values)]
