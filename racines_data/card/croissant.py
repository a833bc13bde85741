"""What a dataset says of itself to machines: `croissant.json`.

Format: Croissant 1.1 and Croissant RAI 1.0 (mlcommons.org/croissant). The file lists the Parquet
files with size and sha256, a file set for each config and for each of its splits, and a record set
for each config that has files of its own. It cannot list itself; `manifest.json` has its sha256.

File sets are relative to the file's folder: `mlcroissant.Dataset("croissant.json")` reads a local
copy of the dataset, streamed shard by shard.
"""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from datasets import Features, Image

from racines_data.card.columns import describe_column
from racines_data.card.datasheet import rai_fields
from racines_data.card.rights import rights_fields
from racines_data.files import sha256_file, write_atomic
from racines_data.manifest import (
    CROISSANT,
    added_configs,
    config_manifest,
    describe,
    is_turned,
    manifest_labels,
)
from racines_data.records import features_of
from racines_data.schema import SPLITS, trajectory_features
from racines_data.sources.base import PROJECT, maker_of
from racines_data.sources.licence import credited

_PARQUET = "application/x-parquet"
_CONFORMS = ("http://mlcommons.org/croissant/1.1", "http://mlcommons.org/croissant/RAI/1.0")
_TYPES = {"string": "sc:Text"} | {
    name: f"cr:{name.capitalize()}" for name in ("int32", "int64", "float32", "float64")
}
_CR = (
    *("arrayShape", "citeAs", "column", "containedIn", "equivalentProperty", "extract", "field"),
    *("fileObject", "fileProperty", "fileSet", "format", "includes", "isArray", "isLiveDataset"),
    *("jsonPath", "key", "md5", "parentField"),
    *("path", "recordSet", "references", "regex", "repeated", "replace", "samplingRate"),
    *("separator", "source", "subField", "transform"),
)
_CONTEXT = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    **{name: f"cr:{name}" for name in _CR},
    "conformsTo": "dct:conformsTo",
    "cr": "http://mlcommons.org/croissant/",
    "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "dct": "http://purl.org/dc/terms/",
    "description": {"@container": "@language"},
    "examples": {"@id": "cr:examples", "@type": "@json"},
    "name": {"@container": "@language"},
    "rai": "http://mlcommons.org/croissant/RAI/",
    "sc": "https://schema.org/",
}


def add_croissant(manifest: dict[str, Any], folder: Path) -> None:
    """Write `croissant.json` of a sealed dataset and enter it in the manifest's `files`."""
    path = folder / CROISSANT
    write_atomic(path, write_croissant(manifest, folder))
    record = {"sha256": sha256_file(path), "bytes": path.stat().st_size}
    manifest["files"] = dict(sorted({**manifest["files"], CROISSANT: record}.items()))


def write_croissant(manifest: Mapping[str, Any], folder: Path) -> str:
    """Return `croissant.json` of a dataset; files that the manifest has not are hashed."""
    source, version = manifest["source"], manifest["version"]
    document: dict[str, Any] = {
        "@context": _CONTEXT,
        "@type": "sc:Dataset",
        "name": f"racines-{source}",
        "description": f"RACINES, robotic cardiac ultrasound: {describe(manifest)}.",
        "conformsTo": list(_CONFORMS),
        **rights_fields(manifest),
        "version": version,
        "keywords": ["ultrasound", "echocardiography", "robotics", source],
        **_credit(manifest),
        **rai_fields(manifest),
        "distribution": [*_file_objects(manifest, folder), *_file_sets(manifest)],
        "recordSet": list(_record_sets(manifest)),
    }
    return json.dumps(document, indent=1, ensure_ascii=False) + "\n"


def _credit(manifest: Mapping[str, Any]) -> dict[str, Any]:
    """Return whom to name and cite: the makers of all configs, who are not those of the import."""
    configs = ("frames", *added_configs(manifest))
    makers = dict.fromkeys(maker_of(config_manifest(manifest, config)) for config in configs)
    named = [credited(maker) for maker in makers]
    creators = [
        {"@type": "sc:Organization", "name": name, **({"url": url} if url else {})}
        for name, url in named
    ]
    plain = str.maketrans("{}\\", "()/")  # what BibTeX reads as its own
    authors = " and ".join(f"{{{name.translate(plain)}}}" for name, _ in named)
    urls = "".join(f"url = {{{url.translate(plain)}}}, " for _, url in named if url)
    source, digest = manifest["source"], manifest["digest"]
    imported = "" if PROJECT in makers else "recordings imported by "
    cite = (
        f"@misc{{racines-{source}, author = {{{authors}}}, {urls}title = {{{imported}RACINES, "
        f"{source} {manifest['version']}}}, note = {{content sha256 {digest}}}}}"
    )
    return {"creator": creators[0] if len(creators) == 1 else creators, "citeAs": cite}


def config_features(manifest: Mapping[str, Any], config: str) -> Features:
    """Return the features of a config of the dataset."""
    if config == "trajectories":
        return trajectory_features()
    own = config_manifest(manifest, config)
    return features_of(own["source"], manifest_labels(own), is_turned(own))


def _file_objects(manifest: Mapping[str, Any], folder: Path) -> Iterator[dict[str, Any]]:
    configs = manifest["configs"].values()
    for path in sorted({path for splits in configs for paths in splits.values() for path in paths}):
        known = manifest.get("files", {}).get(path, {})
        size = known.get("bytes", (folder / path).stat().st_size)
        yield {
            **_node("cr:FileObject", path),
            "contentUrl": path,
            "contentSize": f"{size} B",
            "encodingFormat": _PARQUET,
            "sha256": known.get("sha256") or sha256_file(folder / path),
        }


def _file_sets(manifest: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    for config, splits in manifest["configs"].items():
        files = [path for paths in splits.values() for path in paths]
        sets = [(config, f"All files of the config {config}.", files)]
        for split, paths in splits.items():
            sets.append((f"{config}-{split}", f"Split {split} of the config {config}.", paths))
        for name, told, paths in sets:
            head = _node("cr:FileSet", f"files/{name}", told)
            yield {**head, "encodingFormat": _PARQUET, "includes": list(paths)}


def _record_sets(manifest: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    yield {
        **_node("cr:RecordSet", "splits", "The splits; a trajectory lies wholly in one of them."),
        "dataType": "cr:Split",
        "key": {"@id": "splits/name"},
        "field": [{"@type": "cr:Field", "@id": "splits/name", "dataType": "sc:Text"}],
        "data": [{"splits/name": split} for split in SPLITS],
    }
    for config, splits in manifest["configs"].items():
        path = next(iter(splits.values()))[0]
        if path.split("/")[1] != config:
            continue  # `sessions`: the rows of `frames` in other splits; its file sets say which
        row = "trajectory" if config == "trajectories" else "frame"
        fields = list(_fields(config, manifest))
        told = f"The config {config}: one row a {row}."
        yield {**_node("cr:RecordSet", config, told), "field": fields}


def _field(
    config: str, name: str, description: str, kind: str, source: Mapping[str, Any]
) -> dict[str, Any]:
    return {
        **_node("cr:Field", f"{config}/{name}", description),
        "dataType": kind,
        "source": {"fileSet": {"@id": f"files/{config}"}, **source},
    }


def _fields(config: str, manifest: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    features, own = config_features(manifest, config), config_manifest(manifest, config)
    if "split" not in features:
        told = "Split of the row, from the name of its file; see the record set `splits`."
        path = rf"^.*data/{config}/({'|'.join(SPLITS)})-.+\.parquet$"
        source = {"extract": {"fileProperty": "fullpath"}, "transform": {"regex": path}}
        yield _field(config, "split", told, "sc:Text", source)
    for name, feature in features.items():
        told, source = describe_column(name, feature, own), {"extract": {"column": name}}
        if isinstance(feature, Image):
            kind, source = "sc:ImageObject", {**source, "transform": {"jsonPath": "bytes"}}
        else:
            kind = _TYPES[feature.dtype]
        yield _field(config, name, told, kind, source)


def _node(kind: str, name: str, description: str = "") -> dict[str, Any]:
    """Return the beginning of a node; a field is named by the last part of its identifier."""
    told = name.rpartition("/")[2] if kind == "cr:Field" else name
    head = {"@type": kind, "@id": name, "name": told}
    return {**head, "description": description} if description else head
