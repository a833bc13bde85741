"""Adding a config to a dataset that stands: patients beside the one phantom.

    dataset ──links──> a folder beside it <── shards, store, measures of the new config
                          └─> new README.md, croissant.json, manifest.json ──> swapped in place

All other configs keep their bytes and digests. The new one has a source, a version, a recipe and a
digest of its own, under its name in the manifest, and does not enter those of the dataset.
"""

import json
import shutil
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, cast

import pyarrow as pa

from racines_data.build.planning import FORMAT, DataConfig, check_part, plan_units
from racines_data.build.staging import REMEDY, stage_units, staging_folder
from racines_data.build.writer import (
    Part,
    count_wholes,
    digest_rows,
    write_canonical,
    write_parquet,
    write_part,
)
from racines_data.card.contact_sheet import write_sheet
from racines_data.card.croissant import add_croissant
from racines_data.card.markdown import write_card
from racines_data.card.rewrite import link_files, record_files
from racines_data.digest import check_files, recipe_digest
from racines_data.engines import Engine
from racines_data.errors import RacinesError
from racines_data.files import locked_place, swap_folder, write_atomic
from racines_data.manifest import (
    ADDED,
    CARD,
    CROISSANT,
    DIGEST_VERSION,
    MANIFEST,
    PICTURES,
    added_configs,
    config_manifest,
    measures_name,
    read_manifest,
    rebuild_hint,
    store_name,
)
from racines_data.schema import SPLITS
from racines_data.sources.base import held_card, labels_of_source, own_card
from racines_data.sources.gate.bounds import bounds_of


def add_config(
    source: Any, root: Path, config: DataConfig, engine: Engine, progress: bool = False
) -> dict[str, Any]:
    """Build the config that a source adds, in the place of an older one of that name.

    What was killed goes on where it stopped.

    Args:
        source: Has `adds`, the config's name, `mask_labels`, and `measures(patient)`; its units
            have `patient` and `split`.
        root: Folder of the dataset, which stands.
        config: Shards, limits.
        engine: Who makes the frames; it is started.
        progress: Show a progress bar on stderr.

    Returns:
        The manifest as it is of that config.

    Raises:
        RacinesError: no dataset at `root`, a damaged one, another build of it is running, or a
            config of another name.
    """
    name, bounds = source.adds, bounds_of(source, config.allow)
    if name not in ADDED:
        raise RacinesError(f"source {source.name} adds {name!r}: name one of {', '.join(ADDED)}")
    read_manifest(root)  # before the work, and once more after it
    units = cast(Sequence[Any], plan_units(source, config))
    recipe = added_recipe(source)
    with staging_folder(root, source, recipe_digest(recipe), config.allow) as folder:
        part = Part(name, source, units, {each.id: each.split for each in units}, folder / name)
        stage_units([(source, units, part.folder, True)], engine, progress, config.allow)
        check_part(part, bounds.allow)
        people = _measure(source, units, folder, engine)
        final = folder / "final"
        # Whoever adds another config at this moment seals before this reads, or after it is sealed.
        with locked_place(root):
            manifest = _without(root, name)
            shutil.rmtree(final, ignore_errors=True)
            link_files(root, final, manifest["files"])
            paths = write_part(final, part, config.shards, progress)
            manifest["configs"][name] = {split: others for split, (others, _) in paths.items()}
            manifest[name] = _record(final, part, people, recipe)
            write_sheet(final, name, manifest[name])
            _seal(final, manifest)
            swap_folder(final, root)
    return config_manifest(manifest, name)


def added_recipe(source: Any) -> dict[str, Any]:
    """Return what decides the config that a source adds; its digest is the recipe digest."""
    named = {"source": source.name, "version": source.version}
    return {"format": FORMAT, **named, "settings": source.recipe()}


def carry(root: Path, final: Path, manifest: dict[str, Any]) -> None:
    """Bring the added configs of the dataset at `root` over to the one that takes its place."""
    old: dict[str, Any] = {}
    with suppress(RacinesError):  # none there, or a damaged one, which is being replaced
        old = read_manifest(root)
    names = added_configs(old) if old else []
    if not names:
        return
    files = {file: old["files"][file] for name in names for file in _files_of(name, old["files"])}
    check_files(root, files, rebuild_hint(old))
    link_files(root, final, files)
    for name in names:
        manifest[name], manifest["configs"][name] = old[name], old["configs"][name]
    manifest["files"] |= files
    (final / CROISSANT).unlink()
    _seal(final, manifest)


def _without(root: Path, name: str) -> dict[str, Any]:
    """Return the manifest of a sound dataset, without a config's files and what lists them."""
    manifest = read_manifest(root)
    check_files(root, manifest["files"], rebuild_hint(manifest))
    gone = {*_files_of(name, manifest["files"]), CROISSANT}
    manifest["files"] = {key: each for key, each in manifest["files"].items() if key not in gone}
    manifest["configs"].pop(name, None)
    manifest.pop(name, None)
    return manifest


def _files_of(name: str, files: Iterable[str]) -> list[str]:
    """Return the files of an added config among those of a dataset."""
    own = f"data/{name}/", f"canonical/{name}/", store_name(name), measures_name(name)
    own = *own, f"{PICTURES}{name}.png"
    return [file for file in files if file.startswith(own)]


def _seal(final: Path, manifest: dict[str, Any]) -> None:
    """Write card, Croissant metadata and manifest, with the added configs in one order."""
    configs = manifest["configs"]
    for name in added_configs(manifest):
        configs[name], manifest[name] = configs.pop(name), manifest.pop(name)
    manifest["files"] = manifest.pop("files")
    write_atomic(final / CARD, write_card(manifest))
    record_files(final, manifest)
    add_croissant(manifest, final)
    write_atomic(final / MANIFEST, json.dumps(manifest, indent=1) + "\n")


# --- who was scanned ------------------------------------------------------------------------------


def _measure(
    source: Any, units: Sequence[Any], folder: Path, engine: Engine
) -> list[dict[str, Any]]:
    """Return a row of true measures a patient, in order; those a killed run has made are kept."""
    splits = {unit.patient: unit.split for unit in units}
    (folder / "measures").mkdir(exist_ok=True)
    paths = {patient: folder / "measures" / f"{patient}.json" for patient in splits}
    missing = [patient for patient, path in paths.items() if not path.exists()]
    made = engine.map(_measure_one, source, missing, remedy=REMEDY)
    for patient, row in zip(missing, made, strict=True):
        write_atomic(paths[patient], json.dumps(row))
    rows = [json.loads(path.read_text(encoding="utf-8")) for path in paths.values()]
    return [{**row, "split": splits[row["patient"]]} for row in rows]


def _measure_one(source: Any, patient: int) -> dict[str, Any]:
    return source.measures(patient)


_KINDS = {bool: pa.bool_(), int: pa.int64(), float: pa.float64(), str: pa.string()}


def _table(people: Sequence[Mapping[str, Any]]) -> pa.Table:
    """Return the table of measures; a list is of names where it is `shown`, else of numbers."""

    def kind(name: str, value: Any) -> pa.DataType:
        if isinstance(value, list):
            return pa.list_(pa.string() if name == "shown" else pa.float64())
        return _KINDS[type(value)]

    schema = pa.schema([(name, kind(name, value)) for name, value in people[0].items()])
    return pa.Table.from_pylist(list(people), schema)


def summary(people: Sequence[Mapping[str, Any]], views: int) -> dict[str, Any]:
    """Count patients by split: sex, pathology, and whose views are not all shown at some pose."""
    found = {}
    for split in SPLITS:
        own = [each for each in people if each["split"] == split]
        unshown = [each for each in own if len(each["shown"]) < views]
        found[split] = {
            "patients": len(own),
            "female": sum(each["female"] for each in own),
            "pathology": _by_pathology(own),
            "unshown": len(unshown),
            "unshown_pathology": _by_pathology(unshown),
        }
    return found


def _by_pathology(people: Sequence[Mapping[str, Any]]) -> dict[str, int]:
    return dict(sorted(Counter(each["pathology"] for each in people).items()))


def _record(
    final: Path, part: Part, people: Sequence[Mapping[str, Any]], recipe: dict[str, Any]
) -> dict[str, Any]:
    """Write measures and canonical frames; return what the manifest keeps of the config."""
    source, rows, name = part.source, part.rows, part.config
    (final / measures_name(name)).parent.mkdir(exist_ok=True)
    write_parquet(final / measures_name(name), _table(people))
    labels = labels_of_source(source)
    return {
        "source": source.name,
        "version": source.version,
        "tag": f"{source.name}-v{source.version}",
        "digest": digest_rows(rows, source.name),
        "digest_version": DIGEST_VERSION,
        "recipe_digest": recipe_digest(recipe),
        "recipe": recipe,
        "labels": list(labels),
        "poses": True,
        "card": held_card(own_card(source)),
        "bounds": None,
        "annotation": None,
        "held_out_session": None,
        "counts": count_wholes(rows, "patients"),
        "people": summary(people, len(labels) - 1),
        "mask_labels": list(getattr(source, "mask_labels", ())),
        "report": {"refused_frames": 0, "flagged": 0},
        "canonical": write_canonical(final, part.tables(), f"canonical/{name}"),
    }
