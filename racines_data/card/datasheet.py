"""What reviewers ask of a dataset: its datasheet, and Croissant's responsible-AI fields.

The questions are those of Gebru et al., Datasheets for Datasets (2021). What Croissant's fields say
too is taken from there, so that the two agree. What depends on the dataset comes from its source's
card, and from `answers`.
"""

from collections.abc import Mapping
from typing import Any

from racines_data.card import answers
from racines_data.escape import visible
from racines_data.manifest import MULTI_PHANTOM, added_configs
from racines_data.sources.base import PROJECT, maker_of, manifest_card
from racines_data.tables import code

_PREPROCESSING = "Frames are 8-bit gray, padded to a square where needed, 128 by 128; PNG."
_MADE = "The developers of RACINES, an open benchmark (Apache-2.0 code)."
_BROUGHT = "RACINES, an open benchmark, has the tool of the import alone."
_SHEET = {
    "Motivation": {
        "For what purpose was it made?": "{purpose}",
        "Who made it?": "{maker}",
        "Are the frames simulated, and by what model?": "{model}",
    },
    "Composition": {
        "What are the instances?": "{instances}.",
        "What does each consist of?": "{instance}",
        "Is anything missing?": "{dataCollectionMissingData}",
        "Are relations between instances explicit?": "{relations}",
        "Are there recommended splits?": "{splits}",
        "Are there errors, noise or bias?": "{dataBiases}",
        "Does it hold personal or sensitive data?": "{personalSensitiveInformation}",
    },
    "Collection": {
        "How was the data acquired?": "{dataCollection}",
        "With what software?": "{software}",
        "Were people involved, and was there an ethical review?": "{people}",
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
        "How is it distributed?": "{distribution}",
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
        "rai:dataUseCases": [answers.uses(manifest)],
        "rai:dataBiases": [card.biases],
        "rai:dataLimitations": [card.limitations],
        "rai:dataSocialImpact": answers.impact(manifest),
        "rai:personalSensitiveInformation": [card.personal],
        "rai:dataReleaseMaintenancePlan": answers.maintenance(manifest),
    }


def datasheet(manifest: Mapping[str, Any]) -> str:
    """Return the datasheet as Markdown, headed by one `###` a section."""
    told = {
        name.removeprefix("rai:"): text if isinstance(text, str) else " ".join(text)
        for name, text in rai_fields(manifest).items()
    }
    told |= {**manifest["report"], **_told(manifest)}
    return "\n\n".join(
        f"### {title}\n\n"
        + "\n\n".join(f"**{ask}** {answer.format_map(told)}" for ask, answer in asked.items())
        for title, asked in _SHEET.items()
    )


def _told(manifest: Mapping[str, Any]) -> dict[str, str]:
    """Return the answers that are in no field of Croissant, by their names in the sheet."""
    maker, source = maker_of(manifest), code(visible(manifest["source"]))
    tag = visible(manifest.get("tag", manifest["version"])).replace("`", "'")
    return {
        "purpose": answers.purpose(manifest),
        "model": answers.model(manifest),
        "instances": _instances(manifest),
        "instance": answers.instance(manifest),
        "relations": answers.relations(manifest),
        "splits": answers.splits(manifest),
        "people": answers.people(manifest),
        "rights": manifest_card(manifest).rights,
        "maker": _MADE if maker == PROJECT else f"{maker}. {_BROUGHT}",
        "software": answers.software(manifest, source),
        "distribution": answers.distribution(manifest, tag),
    }


def _instances(manifest: Mapping[str, Any]) -> str:
    """Return how many frames there are, in which configs."""
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
    return instances
