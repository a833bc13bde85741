"""The sections of a card, each a piece of Markdown; empty where there is nothing to say."""

from collections.abc import Mapping
from typing import Any

from racines_data.card import tables as card_tables
from racines_data.card.statistics import has_paper
from racines_data.manifest import MULTI_PHANTOM, manifest_labels
from racines_data.sources.card import manifest_card
from racines_data.tables import Markdown, code, markdown_table


def summary(manifest: Mapping[str, Any], origin: str) -> str:
    """Return the head of the card; its first line names the source."""
    source, version = manifest["source"], manifest["version"]
    return f"""\
**Source: `{source}` — {origin}.**

# RACINES, {source} {version}

Ultrasound frames for robotic scanning: each image with the probe's pose, force and torque, the view
it shows and its grade, in sweeps towards standard views and at random. For training and scoring
image generators, view graders and scanning agents.

**This is research software, not a medical device.** Nothing here is for clinical use.

{picture(manifest, "samples")}"""


def contents(manifest: Mapping[str, Any]) -> str:
    """Return versions and digests."""
    rows = [
        ("version", f"{manifest['source']} {manifest['version']}"),
        ("tag", code(manifest.get("tag", ""))),
        ("content digest", code(manifest["digest"])),
    ]
    many = manifest.get(MULTI_PHANTOM)
    if many:
        rows.append((Markdown(f"content digest of `{MULTI_PHANTOM}`"), code(many["digest"])))
    rows.append(("recipe digest", code(manifest["recipe_digest"])))
    annotation = manifest.get("annotation")
    if annotation:
        rows.append(("annotated by the grader", code(annotation.get("grader"))))
    return f"""\
## Version and digests

{markdown_table(("", ""), rows)}

The *content* digest is of the pixels, numbers and splits; it is equal for rebuilds on one platform.
The *recipe* digest is of what they are made from: source, version, settings, seed, inputs. The
frames in `canonical/` tell whether a rebuild on another processor is the same version: within one
gray level. `manifest.json` has the sha256 of every file, which `racines data validate` checks."""


def rows(manifest: Mapping[str, Any]) -> str:
    """Return what a row is."""
    views = ", ".join(manifest_labels(manifest)[:-1])
    return f"""\
## What a row is

One frame. Robot base frame, SI units; views are {views}, and `Random` for none of them.

{card_tables.columns_table()}"""


def configs(manifest: Mapping[str, Any]) -> str:
    """Return the configs and their splits."""
    held = manifest["held_out_session"]
    lines = [
        "- `frames` (default): one row a frame; splits by trajectory, stratified by target view.",
        "- `trajectories`: one row a trajectory, in the same splits, with its digest.",
        "- No `sessions` config: there is only one session, so none can be held out."
        if held is None
        else f"- `sessions`: the same rows with the whole session `{held}` as test, the rest as "
        "train.",
    ]
    many = manifest.get(MULTI_PHANTOM)
    if many:
        lines.append(
            f"- `{MULTI_PHANTOM}`: the columns of `frames`, from {many['hearts']} other simulated "
            "hearts (seeds in the column `phantom`); splits by heart."
        )
    listed = "\n".join(lines)
    return f"""\
## Configs and splits

{listed}

{card_tables.splits_table(manifest)}

{picture(manifest, "hearts")}"""


def loading(manifest: Mapping[str, Any]) -> str:
    """Return how to load and stream."""
    many = MULTI_PHANTOM in manifest["configs"]
    extra = f'hearts = racines_data.load(config="{MULTI_PHANTOM}")\n' if many else ""
    tag = manifest.get("tag", manifest["version"])
    return f"""\
## Load

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

test = racines_data.load(version="{manifest["version"]}", split="test")
{extra}store = racines_data.open_store()
batch = next(store.batches("train", batch_size=64, seed=0))
```"""


def making(manifest: Mapping[str, Any], collection: str) -> str:
    """Return how it was made."""
    return f"""\
## How it was made

{collection}

{picture(manifest, "trajectories")}"""


def statistics(manifest: Mapping[str, Any]) -> str:
    """Return the twelve parameters, beside the paper's where they are the measure."""
    if not manifest.get("statistics", {}).get("parameters"):
        return ""
    note = (
        "Each cell: this dataset / the paper (144,668 real frames). The paper's figures are as "
        "reported, on other data. rotation_x jumps between −π and +π, so its mean says little."
        if has_paper(manifest)
        else "Of the frames in which the parameter was measured."
    )
    return f"""\
## Statistics

{note}

{card_tables.statistics_table(manifest)}

{picture(manifest, "parameters")}"""


def shares(manifest: Mapping[str, Any]) -> str:
    """Return the shares of classes and grades by split."""
    found = manifest.get("statistics")
    if not found or not any(sum(c.values()) - c["unknown"] for c in found["views"].values()):
        return ""
    note = "A frame that shows no standard view is `Random`, also on the way to one."
    if has_paper(manifest):
        note += " CACTUS: shares of its 37,736 images of such a block, chosen by its authors."
    parts = ["## Classes and grades", note, card_tables.classes_table(manifest)]
    if any(sum(each["counts"]) for each in found["grades"].values()):
        parts.append("Rounded grades of the frames that show a view:")
        parts.append(card_tables.grades_table(manifest))
    return "\n\n".join([*parts, picture(manifest, "shares")])


def limits(manifest: Mapping[str, Any], uses: str, limits_of_source: str) -> str:
    """Return intended use and limits."""
    lines = [uses, limits_of_source]
    report = manifest["report"]
    if report["refused_frames"] or report["flagged"]:
        lines.append(
            f"{report['refused_frames']} frames were refused and {report['flagged']} inputs "
            "flagged; `import_report.parquet` gives each with its reason."
        )
    empty = [split for split, count in manifest["counts"]["splits"].items() if not count["frames"]]
    if empty:
        lines.append(f"Too few trajectories for the split(s) {', '.join(empty)}.")
    return "\n\n".join(["## Intended use and limits", *lines])


def picture(manifest: Mapping[str, Any], name: str) -> str:
    """Return a picture with its caption, empty if it was not drawn."""
    if name not in manifest.get("pictures", []):
        return ""
    caption = _captions(manifest)[name]
    return f"![{caption}](card/{name}.png)\n\n*{caption}.*"


def _captions(manifest: Mapping[str, Any]) -> dict[str, str]:
    found = manifest["statistics"]
    measured = found["parameters"]
    graded = any(sum(each["counts"]) for each in found["grades"].values())
    values = ["grade"] * graded
    values += ["position (mm)", "rotation (degrees)"] * ("position_x" in measured)
    values += ["force (N)"] * ("force_x" in measured)
    order = "from the best grade to the worst" if graded else "from bright to dark"
    over = " over the block" if manifest_card(manifest).simulated else ""
    sweeps = "; the grade along one sweep of each view (shaded: the view is attained)"
    return {
        "samples": f"Frames of each view, {order}, with {', '.join(values) or 'nothing measured'}",
        "parameters": "Distribution of the measured parameters",
        "shares": "Shares of the classes" + ", and of the grades, by split" * graded,
        "trajectories": f"Paths of the probe{over}, by target view{sweeps * graded}",
        "hearts": f"The best frame of the first view in several hearts of `{MULTI_PHANTOM}`",
    }
