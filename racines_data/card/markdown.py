"""The dataset card: YAML that `datasets` reads, and what a reader has to know, by sections."""

from collections.abc import Iterator, Mapping
from typing import Any

import yaml

from racines_data.card import frames
from racines_data.card.answers import introduction, split_by
from racines_data.card.columns import (
    PIXELS_UNIT,
    TURN_COLUMNS,
    columns_table,
    frame_columns,
    frame_note,
)
from racines_data.card.croissant import config_features
from racines_data.card.datasheet import datasheet, rai_fields
from racines_data.card.patients import patients_section
from racines_data.card.realism import realism_section
from racines_data.escape import visible
from racines_data.manifest import (
    MULTI_PHANTOM,
    added_configs,
    describe,
    is_turned,
    manifest_labels,
    scale_known,
)
from racines_data.sources.base import manifest_card
from racines_data.tables import Markdown, code, escape, markdown_table
from racines_data.views import LABELS

_SIZES = ((10**3, "n<1K"), (10**4, "1K<n<10K"), (10**5, "10K<n<100K"), (10**6, "100K<n<1M"))
_WARNING = """\
**This is research software, not a medical device.** Nothing here is for clinical use."""
_LOADING = """\
```python
import datasets

frames = datasets.load_dataset("racines")  # a folder of this name, or the repository on a hub
stream = datasets.load_dataset("racines", split="train", streaming=True)  # shard by shard
print(next(iter(stream))["image"].size)
```

From a hub give `revision="{tag}"` to stay with this version. With the package,
digests are checked first, and training reads whole batches from a memory map:

```python
import racines_data

test = racines_data.load(version="{version}", split="test")
{hearts}store = racines_data.open_store()
batch = next(store.batches("train", batch_size=64, seed=0))
```"""
_DIGESTS = """\
The *content* digest is of source, pixels, numbers and splits; it is equal for rebuilds on one
platform. The *recipe* digest is of what they are made from: source, version, settings, seed,
inputs. The frames in `canonical/` tell whether a rebuild on another processor is the same version:
within the tolerance of `racines data validate --against`. `manifest.json` has the sha256 of every
file, which `racines data validate` checks."""


def _as_text(manifest: Mapping[str, Any]) -> dict[str, Any]:
    """Return a manifest whose own card is text; that of a source of ours is Markdown."""
    held = manifest.get("card") or {}
    words = {key: escape(value) if isinstance(value, str) else value for key, value in held.items()}
    return {**manifest, "card": words}


def write_card(manifest: Mapping[str, Any]) -> str:
    """Return README.md of a dataset: YAML front matter, the card, the datasheet.

    Figures and pictures are those that the manifest names (`statistics`, `pictures`, `realism`);
    without them their sections are left out.
    """
    head = yaml.safe_dump(
        _seen(_front_matter(manifest)), sort_keys=False, allow_unicode=True, width=1000
    )
    shown = _as_text(manifest)
    card = manifest_card(shown)
    source, version = visible(manifest["source"]), visible(manifest["version"])
    views = escape(", ".join(manifest_labels(manifest)[:-1]))
    many = MULTI_PHANTOM in manifest["configs"]
    hearts = f'hearts = racines_data.load(config="{MULTI_PHANTOM}")\n' if many else ""
    for name in added_configs(manifest):
        hearts += f'{name} = racines_data.load(config="{name}")\n'
    parts = [
        f"**Source: {code(source)} — {card.origin}.**",
        f"# RACINES, {escape(f'{source} {version}')}",
        introduction(manifest),
        _WARNING,
        _picture(manifest, "samples"),
        "## What a row is",
        f"One frame. {frame_note(manifest)}; views are {views}, and `Random` for none of them.",
        columns_table(frame_columns(manifest)),
        *_turned(manifest),
        "## Configs and splits",
        "\n".join(_configs(manifest)),
        frames.splits_table(manifest),
        _picture(manifest, "hearts"),
        *patients_section(manifest),
        "## Load",
        _LOADING.format(
            tag=_quoted(manifest.get("tag", version)), version=_quoted(version), hearts=hearts
        ),
        "## Version and digests",
        _versions(manifest),
        _DIGESTS,
        "## How it was made",
        card.collection,
        _picture(manifest, "trajectories"),
        *_statistics(manifest),
        *_shares(manifest),
        realism_section(manifest),
        "## Intended use and limits",
        rai_fields(shown)["rai:dataUseCases"][0],
        card.limits,
        *_losses(manifest),
        "## Datasheet",
        datasheet(shown),
    ]
    body = "\n\n".join(part.strip() for part in parts if part.strip())
    return f"---\n{head}---\n{body}\n"


def _quoted(text: str) -> str:
    """Return text that stands between quotation marks, in code."""
    return visible(text).translate({ord(mark): "'" for mark in '"`\\'})


def _seen(value: Any) -> Any:
    """Return front matter whose texts have no character that is not seen."""
    if isinstance(value, Mapping):
        return {key: _seen(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_seen(each) for each in value]
    return visible(value) if isinstance(value, str) else value


def _front_matter(manifest: Mapping[str, Any]) -> dict[str, Any]:
    configs, infos = [], []
    for name, paths in manifest["configs"].items():
        files = [{"split": split, "path": list(paths[split])} for split in paths]
        config = {"config_name": name, "data_files": files}
        default = {"default": True} if name == "frames" else {}
        about = {"version": manifest["version"], "description": describe(manifest, name)}
        configs.append({**config, **default, **about})
        features = config_features(manifest, name)._to_yaml_list()
        infos.append({"config_name": name, "features": features})
    source, card, frames = manifest["source"], manifest_card(manifest), manifest["counts"]["frames"]
    heart, poses = manifest_labels(manifest) == LABELS, manifest.get("poses", True)
    organ = ["echocardiography"] * (card.labelled and heart)
    tasks = ["image-classification"] * card.labelled
    tasks += ["reinforcement-learning", "robotics"] * poses
    return {
        "pretty_name": f"RACINES ({source} {manifest['version']})",
        "license": card.license,
        "language": ["zxx"],  # ISO 639-2: no linguistic content
        "annotations_creators": ["machine-generated" if card.simulated else "other"],
        "task_categories": tasks,
        "size_categories": [next((name for top, name in _SIZES if frames < top), "1M<n<10M")],
        "tags": ["ultrasound", *organ, "robotics", "medical", source, *card.tags],
        "configs": configs,
        "dataset_info": infos,
    }


def _configs(manifest: Mapping[str, Any]) -> Iterator[str]:
    """Yield a line for each config."""
    held, many = manifest["held_out_session"], manifest.get(MULTI_PHANTOM)
    yield f"- `frames` (default): one row a frame; splits by {split_by(manifest)}."
    yield "- `trajectories`: one row a trajectory, in the same splits, with its digest."
    if held is None:
        yield "- No `sessions` config: there is only one session, so none can be held out."
    else:
        kept = f"the same rows with the whole session {code(held)} as test, the rest as train."
        yield f"- `sessions`: {kept}"
    if many:
        yield (
            f"- `{MULTI_PHANTOM}`: the columns of `frames`, from {many['hearts']} other simulated "
            "hearts (seeds in the column `phantom`); splits by heart."
        )
    for name in added_configs(manifest):
        still = "hearts that beat and breathe" if name == "beating" else "hearts that stand still"
        yield (
            f"- `{name}`: frames of {manifest[name]['counts']['patients']} simulated patients, "
            f"{still}; more columns than `frames`; splits by patient."
        )


def _turned(manifest: Mapping[str, Any]) -> Iterator[str]:
    """Yield what frames of a rotation about the apex have besides, and what splits them."""
    if not is_turned(manifest):
        return
    turns = manifest["turns"]
    yield "Besides, of a rotation about the apex:"
    yield columns_table(TURN_COLUMNS)
    blocks = "one wide block" if turns["split"] == "gap" else "several narrow blocks"
    yield (
        f"{turns['count']} turns, each a trajectory of {turns['phases']} phases of one beat. "
        f"Splits hold out {blocks} of turns by their angle, modulo 180°: a test turn lies "
        f"{turns['median']:.2g}° from the nearest training turn (median), "
        f"{turns['farthest']:.2g}° at most."
    )
    if not scale_known(manifest):
        yield (
            "**The scale is unknown: positions are in pixels of the recorded images, not in "
            "metres,** and nothing may be told in millimetres."
        )


def _versions(manifest: Mapping[str, Any]) -> str:
    rows = [
        ("version", f"{manifest['source']} {manifest['version']}"),
        ("tag", code(manifest.get("tag", ""))),
        ("content digest", code(manifest["digest"])),
    ]
    many, annotation = manifest.get(MULTI_PHANTOM), manifest.get("annotation")
    if many:
        rows.append((Markdown(f"content digest of `{MULTI_PHANTOM}`"), code(many["digest"])))
    for name in added_configs(manifest):
        own = manifest[name]
        rows.append((Markdown(f"`{name}`"), f"{own['source']} {own['version']}"))
        rows.append((Markdown(f"content digest of `{name}`"), code(own["digest"])))
        rows.append((Markdown(f"recipe digest of `{name}`"), code(own["recipe_digest"])))
    rows.append(("recipe digest", code(manifest["recipe_digest"])))
    if annotation:
        rows.append(("annotated by the grader", code(annotation.get("grader"))))
    return markdown_table(("", ""), rows)


def _statistics(manifest: Mapping[str, Any]) -> Iterator[str]:
    """Yield the twelve parameters, beside the paper's where they are the measure."""
    if not manifest.get("statistics", {}).get("parameters"):
        return
    yield "## Statistics"
    yield (
        "Each cell: this dataset / the paper (144,668 real frames). The paper's figures are as "
        "reported, on other data. rotation_x jumps between −π and +π, so its mean says little."
        if frames.has_paper(manifest)
        else "Of the frames in which the parameter was measured."
    )
    yield frames.statistics_table(manifest)
    yield _picture(manifest, "parameters")


def _shares(manifest: Mapping[str, Any]) -> Iterator[str]:
    """Yield the shares of classes and grades by split."""
    found = manifest.get("statistics")
    if not found or not any(sum(c.values()) - c["unknown"] for c in found["views"].values()):
        return
    note = "A frame that shows no standard view is `Random`, also on the way to one."
    if frames.has_paper(manifest):
        note += " CACTUS: shares of its 37,736 images of such a block, chosen by its authors."
    yield "## Classes and grades"
    yield note
    yield frames.classes_table(manifest)
    if _graded(manifest):
        yield "Rounded grades of the frames that show a view:"
        yield frames.grades_table(manifest)
    yield _picture(manifest, "shares")


def _losses(manifest: Mapping[str, Any]) -> Iterator[str]:
    """Yield what was refused, and which splits are empty."""
    report, splits = manifest["report"], manifest["counts"]["splits"]
    if report["refused_frames"] or report["flagged"]:
        yield (
            f"{report['refused_frames']} frames were refused and {report['flagged']} inputs "
            "flagged; `import_report.parquet` gives each with its reason."
        )
    empty = [split for split, count in splits.items() if not count["frames"]]
    if empty:
        yield f"Too few trajectories for the split(s) {', '.join(empty)}."


def _graded(manifest: Mapping[str, Any]) -> bool:
    return any(sum(each["counts"]) for each in manifest["statistics"]["grades"].values())


def _picture(manifest: Mapping[str, Any], name: str) -> str:
    """Return a picture with its caption, empty if it was not drawn."""
    if name not in manifest.get("pictures", []):
        return ""
    measured, graded = manifest["statistics"]["parameters"], _graded(manifest)
    values = ["grade"] * graded
    length = "mm" if scale_known(manifest) else PIXELS_UNIT
    values += [f"position ({length})", "rotation (degrees)"] * ("position_x" in measured)
    values += ["force (N)"] * ("force_x" in measured)
    order = "from the best grade to the worst" if graded else "from bright to dark"
    over = " over the block" if manifest_card(manifest).simulated else ""
    sweeps = "; the grade along one sweep of each view (shaded: the view is attained)"
    caption = {
        "samples": f"Frames of each view, {order}, with {', '.join(values) or 'nothing measured'}",
        "parameters": "Distribution of the measured parameters",
        "shares": "Shares of the classes" + ", and of the grades, by split" * graded,
        "trajectories": f"Paths of the probe{over}, by target view{sweeps * graded}",
        "hearts": f"The best frame of the first view in several hearts of `{MULTI_PHANTOM}`",
    }[name]
    return f"![{caption}](card/{name}.png)\n\n*{caption}.*"
