"""What a dataset says of itself: `croissant.json` to machines, the datasheet to reviewers.

Format: Croissant 1.1 and Croissant RAI 1.0 (mlcommons.org/croissant). The file lists the Parquet
files with size and sha256, a file set for each config and for each of its splits, and a record set
for each config that has files of its own. It cannot list itself; `manifest.json` has its sha256.

File sets are relative to the file's folder: `mlcroissant.Dataset("croissant.json")` reads a local
copy of the dataset, streamed shard by shard.

The datasheet asks the questions of Gebru et al., Datasheets for Datasets (2021). What Croissant's
responsible-AI fields say too is taken from there, so that the two agree.
"""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from datasets import ClassLabel, Features, Image

from racines_data.card.frames import unit_of
from racines_data.escape import visible
from racines_data.files import sha256_file, write_atomic
from racines_data.manifest import (
    CROISSANT,
    MULTI_PHANTOM,
    added_configs,
    config_manifest,
    describe,
    is_turned,
    manifest_labels,
)
from racines_data.records import features_of
from racines_data.schema import CONTROLS, PARAMETERS, SPLITS, trajectory_features
from racines_data.sources.base import PROJECT, maker_of, manifest_card
from racines_data.sources.licence import credited

_PARQUET = "application/x-parquet"
_CONFORMS = ("http://mlcommons.org/croissant/1.1", "http://mlcommons.org/croissant/RAI/1.0")
_URLS = {"cc-by-4.0": "https://creativecommons.org/licenses/by/4.0/"}
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
_COLUMNS = {
    "image": "The frame: 8-bit gray, 128 by 128, beam axis down, probe at the top centre; PNG.",
    "timestamp": "Time of the frame, s; null where there is no clock.",
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
    "patient": "Seed of the simulated patient; a patient lies wholly in one split.",
    "cardiac_phase": "Where the heart is in its beat, in [0, 1) from end diastole.",
    "respiratory_phase": "Where the chest is in its breath, in [0, 1) from breathed out.",
    "turn_angle": "Angle of the turn about the apex, in [0, 180) degrees.",
    "train_angle": "Angle from the turn to the nearest turn of the train split, degrees.",
    "mask": "Label of what each pixel of the image shows; PNG; null where there are no masks.",
    "split": "Split of the trajectory.",
    "frames": "Number of frames of the trajectory.",
    "duration": "Duration of the trajectory, s.",
    "digest": "sha256 of the trajectory's pixels and numbers.",
}
_USES = (
    "Training and scoring of image generators conditioned on the probe's pose and force, of view "
    "and grade classifiers, and of scanning agents, on the RACINES leaderboard. Not for: "
    "diagnosis, guidance of examinations of people, or claims about clinical performance. "
    "Research software, not a medical device."
)
_IMPACT = (
    "Meant to make research on robotic ultrasound reproducible without access to a robot or to "
    "patients' data. The risk is overconfidence: a system that does well here has been shown to do "
    "well on a phantom only."
)
_PREPROCESSING = "Frames are 8-bit gray, padded to a square where needed, 128 by 128; PNG."
_MAINTENANCE = (
    "Versions are semantic and tagged `SOURCE-vX.Y.Z`; a tag is never moved. Each version has a "
    "content digest and a recipe digest, and every file a sha256. A fault found is corrected in a "
    "new version and named in the changelog; old versions stay available."
)
_MADE = "The developers of RACINES, an open benchmark (Apache-2.0 code)."
_BROUGHT = "RACINES, an open benchmark, has the tool of the import alone."
_SHEET = {
    "Motivation": {
        "For what purpose was it made?": "To let image generators and scanning agents for robotic "
        "cardiac ultrasound be trained, scored and compared by anyone: each frame comes with the "
        "probe's pose, force and torque. It follows the RACINES dataset of the paper that "
        "introduced the task.",
        "Who made it?": "{maker}",
        "Is there a model behind the simulated sources?": "Yes: a parametric heart in a gel block, "
        "its acoustics and its contact with a probe, all in `racines_data/phantom`. Only the "
        "source `phantom` is simulated.",
    },
    "Composition": {
        "What are the instances?": "{instances}.",
        "What does each consist of?": "An image of 128×128 gray pixels, twelve numbers of pose, "
        "force and torque, the commanded velocity, a time, a view and a grade: the table of "
        "columns above.",
        "Is anything missing?": "{dataCollectionMissingData}",
        "Are relations between instances explicit?": "Neighbouring rows of a trajectory are "
        "consecutive frames of one sweep, hence near-copies; `trajectory`, `frame` and `session` "
        "say so. Two neighbouring rows are a transition (state, action, next state).",
        "Are there recommended splits?": "Yes, `train`, `validation` and `test`, by whole "
        "trajectories and stratified by target view. Do not split by frame: the near-copies would "
        "leak.",
        "Are there errors, noise or bias?": "{dataBiases}",
        "Does it hold personal or sensitive data?": "{personalSensitiveInformation}",
    },
    "Collection": {
        "How was the data acquired?": "{dataCollection}",
        "With what software?": "`racines data build` (sources `phantom`, `tracked`) and `racines "
        "data import` (`release`, `cactus`); version, settings, seed and inputs are the recipe in "
        "`manifest.json`.",
        "Were people involved, and was there an ethical review?": "The sources `phantom`, "
        "`release` and `cactus` show a phantom: no person was scanned. For `tracked`, whoever "
        "imports recordings of people answers for consent and review.",
    },
    "Preprocessing, labelling": {
        "Was the data preprocessed?": "{dataPreprocessingProtocol}",
        "How was it labelled?": "{dataAnnotationProtocol}",
        "Was anything refused?": "{refused_frames:,} frames refused, {flagged:,} inputs flagged; "
        "`import_report.parquet` gives each with its reason.",
    },
    "Uses": {
        "What is it for, and what not?": "{dataUseCases}",
        "What limits its use?": "{dataLimitations}",
        "What could go wrong?": "{dataSocialImpact}",
    },
    "Distribution": {
        "Under what licence?": "{rights}",
        "How is it distributed?": "As a folder of Parquet files that `datasets` reads, built from "
        "its recipe by one command or fetched from a hub under its tag `{tag}`. `croissant.json`, "
        "where present, describes it for other readers.",
    },
    "Maintenance": {
        "Who maintains it, and how is it versioned?": "{dataReleaseMaintenancePlan}",
        "Where are errors recorded?": "An error is corrected in a new version, never in place; "
        "`racines data validate` checks files, digests, splits, labels and statistics of any copy.",
        "Can others extend it?": "Yes: another source, organ or recording is a plug-in (entry "
        "points `racines.sources` and `racines.anatomies`); see `docs/dataset.md` and "
        "`docs/phantom.md` of the repository.",
    },
}
"""Questions and answers by section; in braces what the dataset says itself."""


def add_croissant(manifest: dict[str, Any], folder: Path) -> None:
    """Write `croissant.json` of a sealed dataset and enter it in the manifest's `files`."""
    path = folder / CROISSANT
    write_atomic(path, write_croissant(manifest, folder))
    record = {"sha256": sha256_file(path), "bytes": path.stat().st_size}
    manifest["files"] = dict(sorted({**manifest["files"], CROISSANT: record}.items()))


def write_croissant(manifest: Mapping[str, Any], folder: Path) -> str:
    """Return `croissant.json` of a dataset; files that the manifest has not are hashed."""
    source, version = manifest["source"], manifest["version"]
    license_ = manifest_card(manifest).license
    document: dict[str, Any] = {
        "@context": _CONTEXT,
        "@type": "sc:Dataset",
        "name": f"racines-{source}",
        "description": f"RACINES, robotic cardiac ultrasound: {describe(manifest)}.",
        "conformsTo": list(_CONFORMS),
        "license": _URLS.get(license_, license_),
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


def rai_fields(manifest: Mapping[str, Any]) -> dict[str, Any]:
    """Return what a user should know before using a dataset: its properties `rai:`, by name."""
    card, report = manifest_card(manifest), manifest.get("report", {})
    grader = manifest.get("annotation", {}).get("grader")
    tools = [f"RACINES grader, weights sha256 {grader}"] if grader else []
    missing = (
        f"Measurements that are not known are null. {report.get('refused_frames', 0)} frames were "
        f"refused and {report.get('flagged', 0)} inputs flagged; import_report.parquet gives each "
        "with its reason."
    )
    return {
        "rai:dataCollection": card.collection,
        "rai:dataCollectionType": [card.collection_type],
        "rai:dataCollectionMissingData": missing,
        "rai:dataCollectionRawData": f"Recipe sha256 {manifest['recipe_digest']}, in the manifest.",
        "rai:dataPreprocessingProtocol": [_PREPROCESSING],
        "rai:dataAnnotationProtocol": card.annotation,
        "rai:machineAnnotationTools": tools,
        "rai:dataUseCases": [_USES],
        "rai:dataBiases": [card.biases],
        "rai:dataLimitations": [card.limitations],
        "rai:dataSocialImpact": _IMPACT,
        "rai:personalSensitiveInformation": [card.personal],
        "rai:dataReleaseMaintenancePlan": _MAINTENANCE,
    }


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
        fields = list(_fields(config, config_features(manifest, config)))
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


def _fields(config: str, features: Features) -> Iterator[dict[str, Any]]:
    if "split" not in features:
        told = "Split of the row, from the name of its file; see the record set `splits`."
        path = rf"^.*data/{config}/({'|'.join(SPLITS)})-.+\.parquet$"
        source = {"extract": {"fileProperty": "fullpath"}, "transform": {"regex": path}}
        yield _field(config, "split", told, "sc:Text", source)
    for name, feature in features.items():
        told, source = _describe_column(name, feature), {"extract": {"column": name}}
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


def _describe_column(name: str, feature: Any) -> str:
    kind, _, axis = name.partition("_")
    if name in PARAMETERS:
        euler = "; extrinsic xyz Euler angle" if kind == "rotation" else ""
        return f"{kind.capitalize()} {axis}, {unit_of(name)}, robot base frame{euler}; nullable."
    if name in CONTROLS:
        unit = "rad/s" if axis.startswith("r") else "m/s"
        return f"Commanded velocity {axis}, {unit}, robot base frame; null where unknown."
    names = f" One of {', '.join(feature.names)}." if isinstance(feature, ClassLabel) else ""
    return f"{_COLUMNS[name]}{names}"


def datasheet(manifest: Mapping[str, Any]) -> str:
    """Return the datasheet as Markdown, headed by one `###` a section."""
    counts, many = manifest["counts"], manifest.get(MULTI_PHANTOM)
    instances = (
        f"Ultrasound frames: {counts['frames']:,} in {counts['trajectories']:,} trajectories of "
        f"{len(counts['sessions'])} session(s)"
    )
    if many:
        instances += (
            f"; and, in `{MULTI_PHANTOM}`, {many['frames']:,} of {many['hearts']} other simulated "
            "hearts"
        )
    for name in added_configs(manifest):
        own = manifest[name]["counts"]
        instances += (
            f"; and, in `{name}`, {own['frames']:,} of {own['patients']} simulated patients"
        )
    told = {
        name.removeprefix("rai:"): text if isinstance(text, str) else " ".join(text)
        for name, text in rai_fields(manifest).items()
    }
    told |= {**manifest["report"], "instances": instances, "rights": manifest_card(manifest).rights}
    maker = maker_of(manifest)
    told["maker"] = _MADE if maker == PROJECT else f"{maker}. {_BROUGHT}"
    told |= {"tag": visible(manifest.get("tag", manifest["version"])).replace("`", "'")}
    return "\n\n".join(
        f"### {title}\n\n"
        + "\n\n".join(f"**{ask}** {answer.format_map(told)}" for ask, answer in asked.items())
        for title, asked in _SHEET.items()
    )
