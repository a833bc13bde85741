"""Croissant metadata of a dataset, with the Responsible-AI vocabulary: `croissant.json`.

Format: Croissant 1.0 and Croissant RAI 1.0 (mlcommons.org/croissant). The file lists the Parquet
files with size and sha256, a file set for each config and for each of its splits, and a record set
for each config that has files of its own. It cannot list itself; `manifest.json` has its sha256.

File sets are relative to the file's folder: `mlcroissant.Dataset("croissant.json")` reads a local
copy of the dataset, streamed shard by shard.
"""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from datasets import ClassLabel, Features, Image

from racines_data.card.croissant_rai import rai_fields
from racines_data.files import sha256_file, write_atomic
from racines_data.manifest import describe, manifest_labels
from racines_data.records import features_of
from racines_data.schema import CONTROLS, PARAMETERS, SPLITS, trajectory_features
from racines_data.sources.card import manifest_card

CROISSANT = "croissant.json"
_PARQUET = "application/x-parquet"
_CONFORMS = ("http://mlcommons.org/croissant/1.0", "http://mlcommons.org/croissant/RAI/1.0")
_URLS = {"cc-by-4.0": "https://creativecommons.org/licenses/by/4.0/"}
_TYPES = {"string": "sc:Text"} | {
    name: f"cr:{name.capitalize()}" for name in ("int32", "int64", "float32", "float64")
}
_CR = (
    *("citeAs", "column", "equivalentProperty", "extract", "field", "fileObject", "fileProperty"),
    *("fileSet", "format", "includes", "isLiveDataset", "jsonPath", "key", "md5", "parentField"),
    *("path", "recordSet", "references", "regex", "repeated", "replace", "samplingRate"),
    *("separator", "source", "subField", "transform"),
)
_UNITS = {"force": "N", "torque": "N·m", "position": "m", "rotation": "rad"}
_COLUMNS = {
    "image": "The frame: 8-bit gray, 128 by 128, beam axis down, probe at the top centre; PNG.",
    "timestamp": "Time of the frame, s.",
    "view": "What the frame shows; null where unknown.",
    "grade": "Quality of the view, 0-10; null where unknown.",
    "view_predicted": "The view by a trained grader; null until annotated.",
    "grade_predicted": "The grade, 0-10, by a trained grader; null until annotated.",
    "target_view": "What the sweep aimed at; Random for none.",
    "phantom": "Seed of the simulated anatomy, 0 the canonical one; null for recordings.",
    "source": "Where the frame comes from.",
    "session": "Recording session.",
    "trajectory": "Name of the sweep; a sweep lies wholly in one split.",
    "frame": "Number of the frame in its trajectory.",
    "split": "Split of the trajectory.",
    "frames": "Number of frames of the trajectory.",
    "duration": "Duration of the trajectory, s.",
    "digest": "sha256 of the trajectory's pixels and numbers.",
}


def add_croissant(manifest: dict[str, Any], folder: Path) -> None:
    """Write `croissant.json` of a sealed dataset and enter it in the manifest's `files`."""
    path = folder / CROISSANT
    write_atomic(path, write_croissant(manifest, folder))
    record = {"sha256": sha256_file(path), "bytes": path.stat().st_size}
    manifest["files"] = dict(sorted({**manifest["files"], CROISSANT: record}.items()))


def write_croissant(manifest: Mapping[str, Any], folder: Path) -> str:
    """Return `croissant.json` of a dataset.

    Args:
        manifest: The manifest; where it has no `files` yet, the data files are hashed.
        folder: The dataset.
    """
    source, version = manifest["source"], manifest["version"]
    license_ = manifest_card(manifest).license
    document: dict[str, Any] = {
        "@context": _context(),
        "@type": "sc:Dataset",
        "name": f"racines-{source}",
        "description": f"RACINES, robotic cardiac ultrasound: {describe(manifest)}.",
        "conformsTo": list(_CONFORMS),
        "license": _URLS.get(license_, license_),
        "version": version,
        "keywords": ["ultrasound", "echocardiography", "robotics", source],
        "creator": {"@type": "sc:Organization", "name": "The RACINES developers"},
        "citeAs": _citation(manifest),
        **rai_fields(manifest),
        "distribution": [*_file_objects(manifest, folder), *_file_sets(manifest)],
        "recordSet": list(_record_sets(manifest)),
    }
    return json.dumps(document, indent=1, ensure_ascii=False) + "\n"


def _context() -> dict[str, Any]:
    return {
        "@language": "en",
        "@vocab": "https://schema.org/",
        **{name: f"cr:{name}" for name in _CR},
        "conformsTo": "dct:conformsTo",
        "cr": "http://mlcommons.org/croissant/",
        "data": {"@id": "cr:data", "@type": "@json"},
        "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
        "dct": "http://purl.org/dc/terms/",
        "examples": {"@id": "cr:examples", "@type": "@json"},
        "rai": "http://mlcommons.org/croissant/RAI/",
        "sc": "https://schema.org/",
    }


def _citation(manifest: Mapping[str, Any]) -> str:
    source, version = manifest["source"], manifest["version"]
    return (
        f"@misc{{racines-{source}, author = {{{{The RACINES developers}}}}, title = "
        f"{{RACINES, {source} {version}}}, note = {{content sha256 {manifest['digest']}}}}}"
    )


def _file_objects(manifest: Mapping[str, Any], folder: Path) -> Iterator[dict[str, Any]]:
    paths = {
        path
        for config in manifest["configs"].values()
        for files in config.values()
        for path in files
    }
    for path in sorted(paths):
        known = manifest.get("files", {}).get(path, {})
        size = known.get("bytes", (folder / path).stat().st_size)
        yield {
            "@type": "cr:FileObject",
            "@id": path,
            "name": path,
            "contentUrl": path,
            "contentSize": f"{size} B",
            "encodingFormat": _PARQUET,
            "sha256": known.get("sha256") or sha256_file(folder / path),
        }


def _file_sets(manifest: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    for config, splits in manifest["configs"].items():
        files = [path for paths in splits.values() for path in paths]
        yield _file_set(f"files/{config}", f"All files of the config {config}.", files)
        for split, paths in splits.items():
            name = f"files/{config}-{split}"
            yield _file_set(name, f"Split {split} of the config {config}.", paths)


def _file_set(name: str, description: str, paths: list[str]) -> dict[str, Any]:
    return {
        "@type": "cr:FileSet",
        "@id": name,
        "name": name,
        "description": description,
        "encodingFormat": _PARQUET,
        "includes": list(paths),
    }


def _record_sets(manifest: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    yield {
        "@type": "cr:RecordSet",
        "@id": "splits",
        "name": "splits",
        "description": "The splits; a trajectory lies wholly in one of them.",
        "dataType": "cr:Split",
        "key": {"@id": "splits/name"},
        "field": [{"@type": "cr:Field", "@id": "splits/name", "dataType": "sc:Text"}],
        "data": [{"splits/name": split} for split in SPLITS],
    }
    for config, splits in manifest["configs"].items():
        path = next(iter(splits.values()))[0]
        if path.split("/")[1] != config:
            continue  # `sessions`: the rows of `frames` in other splits; its file sets say which
        features = (
            trajectory_features()
            if config == "trajectories"
            else features_of(manifest["source"], manifest_labels(manifest))
        )
        yield {
            "@type": "cr:RecordSet",
            "@id": config,
            "name": config,
            "description": f"The config {config}: one row a "
            + ("trajectory." if config == "trajectories" else "frame."),
            "field": [
                *([] if "split" in features else [_split_field(config)]),
                *(_field(config, name, features) for name in features),
            ],
        }


def _split_field(config: str) -> dict[str, Any]:
    return {
        "@type": "cr:Field",
        "@id": f"{config}/split",
        "name": "split",
        "description": "Split of the row, from the name of its file; see the record set `splits`.",
        "dataType": "sc:Text",
        "source": {
            "fileSet": {"@id": f"files/{config}"},
            "extract": {"fileProperty": "fullpath"},
            "transform": {"regex": rf"^.*data/{config}/({'|'.join(SPLITS)})-.+\.parquet$"},
        },
    }


def _field(config: str, name: str, features: Features) -> dict[str, Any]:
    feature = features[name]
    source: dict[str, Any] = {"fileSet": {"@id": f"files/{config}"}, "extract": {"column": name}}
    if isinstance(feature, Image):
        source["transform"] = {"jsonPath": "bytes"}
        kind = "sc:ImageObject"
    else:
        kind = _TYPES[feature.dtype]
    return {
        "@type": "cr:Field",
        "@id": f"{config}/{name}",
        "name": name,
        "description": _describe_column(name, feature),
        "dataType": kind,
        "source": source,
    }


def _describe_column(name: str, feature: Any) -> str:
    kind, _, axis = name.partition("_")
    if name in PARAMETERS:
        euler = "; extrinsic xyz Euler angle" if kind == "rotation" else ""
        return f"{kind.capitalize()} {axis}, {_UNITS[kind]}, robot base frame{euler}; nullable."
    if name in CONTROLS:
        unit = "rad/s" if axis.startswith("r") else "m/s"
        return f"Commanded velocity {axis}, {unit}, robot base frame; null where unknown."
    names = f" One of {', '.join(feature.names)}." if isinstance(feature, ClassLabel) else ""
    return f"{_COLUMNS[name]}{names}"
