"""The dataset card: YAML that `datasets` reads, and what a reader has to know."""

from collections.abc import Mapping
from typing import Any

import yaml
from datasets import Features

from racines_data.load import config_digest, manifest_labels
from racines_data.records import features_of
from racines_data.schema import trajectory_features

ORIGINS = {
    "phantom": "simulated ultrasound of the RACINES phantom; no frame comes from a scanner",
    "release": "the published RACINES recordings, imported",
    "cactus": "the published CACTUS images, imported; labels and grades without poses",
    "tracked": "tracked freehand ultrasound, imported; poses of the tracked probe, no forces",
}
LICENSES = {"phantom": "cc-by-4.0", "cactus": "cc-by-4.0"}

_TEXT = """\
**Source: `{source}` — {origin}.**

# RACINES, {source} {version}

Ultrasound frames with the probe's pose, force and torque, the view they show and its grade.
Research data, not for clinical use.

| | |
| --- | --- |
| version | {source} {version} |
| content digest | `{digest}` |
| recipe digest | `{recipe_digest}` |
| frames | {frames} |
| trajectories | {trajectories} |
| sessions | {sessions} |

| split | trajectories | frames |
| --- | --- | --- |
{splits}

The *content* digest is of the pixels and numbers; it is equal for rebuilds on one platform. The
*recipe* digest is of what they are made from. The frames in `canonical/` tell whether a rebuild on
another processor is the same version: within one gray level.

## Load

```python
import datasets
frames = datasets.load_dataset("racines")          # in the repository root
import racines_data
frames = racines_data.load(split="train")          # anywhere, digests checked
store = racines_data.open_store()                  # memory-mapped batches for training
```

## Configs

- `frames` (default): one row a frame; splits by trajectory, stratified by target view.
- `trajectories`: one row a trajectory, in the same splits, with its digest.
{session_note}

## Columns

Robot base frame; metres, radians (extrinsic xyz Euler angles), newtons, newton-metres, seconds.
`force_*`, `torque_*`, `control_*`, `view` and `grade` are null where they are not known.
`target_view` is what the sweep aimed at, `view` what the frame shows; `Random` means none.

## Limits

{limits}
"""

_LIMITS = {
    "phantom": (
        "The images are simulated. They are never to be mixed with, or presented as, recordings "
        "of the real block."
    ),
    "tracked": (
        "A recording is one sweep. It is cut into contiguous segments, which stand as trajectories "
        "so that splits exist; frames on both sides of a cut are neighbours in time, so scores on "
        "such splits are optimistic. Poses are those of the tracked probe marker in the tracker's "
        "frame, not of the image plane; there are no forces, views or grades."
    ),
}


def write_card(manifest: Mapping[str, Any]) -> str:
    """Return README.md of a dataset: YAML front matter, then the card."""
    head = yaml.safe_dump(_front_matter(manifest), sort_keys=False, allow_unicode=True, width=1000)
    return f"---\n{head}---\n{_body(manifest)}"


def describe(manifest: Mapping[str, Any], config: str = "frames") -> str:
    """Return the description of a config.

    It carries the digest because `datasets` keys its cache of a local folder by the configs, not by
    the content of the files: without it a rebuilt dataset would be served stale. So it does the
    grader's hash, where one has annotated the frames.
    """
    origin = ORIGINS.get(manifest["source"], "a source of another package")
    annotation = manifest.get("annotation") if config in ("frames", "sessions") else None
    return (
        f"source {manifest['source']} ({origin}); version {manifest['version']}; "
        f"content sha256 {config_digest(manifest, config)}"
        + (f"; annotated by grader {annotation['grader']}" if annotation else "")
    )


def _front_matter(manifest: Mapping[str, Any]) -> dict[str, Any]:
    configs, infos = [], []
    for name, paths in manifest["configs"].items():
        files = [{"split": split, "path": list(paths[split])} for split in paths]
        config: dict[str, Any] = {"config_name": name, "data_files": files}
        if name == "frames":
            config["default"] = True
        configs.append(
            {**config, "version": manifest["version"], "description": describe(manifest, name)}
        )
        features: Features = (
            trajectory_features()
            if name == "trajectories"
            else features_of(manifest["source"], manifest_labels(manifest))
        )
        infos.append({"config_name": name, "features": features._to_yaml_list()})
    return {
        "license": LICENSES.get(manifest["source"], "other"),
        "pretty_name": f"RACINES ({manifest['source']} {manifest['version']})",
        "tags": ["ultrasound", "echocardiography", "robotics", manifest["source"]],
        "configs": configs,
        "dataset_info": infos,
    }


def _body(manifest: Mapping[str, Any]) -> str:
    source, counts = manifest["source"], manifest["counts"]
    rows = [
        f"| {split} | {count['trajectories']} | {count['frames']} |"
        for split, count in counts["splits"].items()
    ]
    return _TEXT.format(
        source=source,
        origin=ORIGINS.get(source, "a source of another package"),
        version=manifest["version"],
        digest=manifest["digest"],
        recipe_digest=manifest["recipe_digest"],
        frames=counts["frames"],
        trajectories=counts["trajectories"],
        sessions=len(counts["sessions"]),
        splits="\n".join(rows),
        session_note=_session_note(manifest),
        limits=_limits(manifest),
    )


def _session_note(manifest: Mapping[str, Any]) -> str:
    held = manifest["held_out_session"]
    if held is None:
        return "- No `sessions` config: there is only one session, so none can be held out."
    return (
        f"- `sessions`: the same rows with the whole session `{held}` as test, the rest as train."
    )


def _limits(manifest: Mapping[str, Any]) -> str:
    lines = [_LIMITS.get(manifest["source"], "See the source.")]
    report = manifest["report"]
    if report["refused_frames"] or report["flagged"]:
        lines.append(
            f"{report['refused_frames']} frames were refused and {report['flagged']} inputs "
            "flagged; `import_report.parquet` gives each with its reason."
        )
    empty = [split for split, count in manifest["counts"]["splits"].items() if not count["frames"]]
    if empty:
        lines.append(f"Too few trajectories for the split(s) {', '.join(empty)}.")
    return "\n\n".join(lines)
