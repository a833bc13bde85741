"""The datasheet of a dataset: the questions of Gebru et al., Datasheets for Datasets (2021).

What Croissant's responsible-AI fields say too is taken from there, so that the two agree.
"""

from collections.abc import Mapping
from typing import Any

from racines_data.card.croissant import rai_fields
from racines_data.manifest import MULTI_PHANTOM
from racines_data.sources.card import manifest_card

_SHEET = {
    "Motivation": {
        "For what purpose was it made?": "To let image generators and scanning agents for robotic "
        "cardiac ultrasound be trained, scored and compared by anyone: each frame comes with the "
        "probe's pose, force and torque. It follows the RACINES dataset of the paper that "
        "introduced the task.",
        "Who made it?": "The developers of RACINES, an open benchmark (Apache-2.0 code).",
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
    told = {
        name.removeprefix("rai:"): text if isinstance(text, str) else " ".join(text)
        for name, text in rai_fields(manifest).items()
    }
    told |= {**manifest["report"], "instances": instances}
    told |= {"rights": manifest_card(manifest).rights}
    told |= {"tag": manifest.get("tag", manifest["version"])}
    return "\n\n".join(
        f"### {title}\n\n"
        + "\n\n".join(f"**{ask}** {answer.format_map(told)}" for ask, answer in asked.items())
        for title, asked in _SHEET.items()
    )
