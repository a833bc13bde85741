"""The datasheet of a dataset: the questions of Gebru et al., Datasheets for Datasets (2021).

What Croissant's responsible-AI fields say too is taken from there, so that the two agree.
"""

from collections.abc import Iterator, Mapping
from typing import Any

from racines_data.card.croissant_rai import rai_fields
from racines_data.manifest import MULTI_PHANTOM
from racines_data.sources.card import manifest_card

_MOTIVATION = (
    (
        "For what purpose was it made?",
        "To let image generators and scanning agents for robotic cardiac ultrasound be trained, "
        "scored and compared by anyone: each frame comes with the probe's pose, force and torque. "
        "It follows the RACINES dataset of the paper that introduced the task.",
    ),
    ("Who made it?", "The developers of RACINES, an open benchmark (Apache-2.0 code)."),
    (
        "Is there a model behind the simulated sources?",
        "Yes: a parametric heart in a gel block, its acoustics and its contact with a probe, all "
        "in `racines_data/phantom`. Only the source `phantom` is simulated.",
    ),
)
_RELATIONS = (
    "Neighbouring rows of a trajectory are consecutive frames of one sweep, hence near-copies; "
    "`trajectory`, `frame` and `session` say so. Two neighbouring rows are a transition (state, "
    "action, next state)."
)
_SPLITS = (
    "Yes, `train`, `validation` and `test`, by whole trajectories and stratified by target view. "
    "Do not split by frame: the near-copies would leak."
)
_SOFTWARE = (
    "`racines data build` (sources `phantom`, `tracked`) and `racines data import` (`release`, "
    "`cactus`); version, settings, seed and inputs are the recipe in `manifest.json`."
)
_ERRATA = (
    "An error is corrected in a new version, never in place; `racines data validate` checks files, "
    "digests, splits, labels and statistics of any copy."
)
_CONTRIBUTE = (
    "Yes: another source, organ or recording is a plug-in (entry points `racines.sources` and "
    "`racines.anatomies`); see `docs/dataset.md` and `docs/phantom.md` of the repository."
)


def datasheet(manifest: Mapping[str, Any]) -> str:
    """Return the datasheet as Markdown, headed by one `###` a section."""
    rai = rai_fields(manifest)
    parts = {
        "Motivation": _MOTIVATION,
        "Composition": tuple(_composition(manifest, rai)),
        "Collection": _collection(rai),
        "Preprocessing, labelling": _preprocessing(manifest, rai),
        "Uses": _uses(rai),
        "Distribution": _distribution(manifest),
        "Maintenance": (
            ("Who maintains it, and how is it versioned?", rai["rai:dataReleaseMaintenancePlan"]),
            ("Where are errors recorded?", _ERRATA),
            ("Can others extend it?", _CONTRIBUTE),
        ),
    }
    return "\n\n".join(
        f"### {title}\n\n" + "\n\n".join(f"**{ask}** {answer}" for ask, answer in answers)
        for title, answers in parts.items()
    )


def _composition(manifest: Mapping[str, Any], rai: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    counts = manifest["counts"]
    told = (
        f"Ultrasound frames: {counts['frames']:,} in {counts['trajectories']:,} trajectories of "
        f"{len(counts['sessions'])} session(s)"
    )
    many = manifest.get(MULTI_PHANTOM)
    if many:
        told += (
            f"; and, in `{MULTI_PHANTOM}`, {many['frames']:,} of {many['hearts']} other simulated "
            "hearts"
        )
    yield "What are the instances?", f"{told}."
    yield (
        "What does each consist of?",
        "An image of 128×128 gray pixels, twelve numbers of pose, force and torque, the commanded "
        "velocity, a time, a view and a grade: the table of columns above.",
    )
    yield "Is anything missing?", str(rai["rai:dataCollectionMissingData"])
    yield "Are relations between instances explicit?", _RELATIONS
    yield "Are there recommended splits?", _SPLITS
    yield "Are there errors, noise or bias?", _joined(rai["rai:dataBiases"])
    yield (
        "Does it hold personal or sensitive data?",
        _joined(rai["rai:personalSensitiveInformation"]),
    )


def _collection(rai: Mapping[str, Any]) -> tuple[tuple[str, str], ...]:
    return (
        ("How was the data acquired?", str(rai["rai:dataCollection"])),
        ("With what software?", _SOFTWARE),
        (
            "Were people involved, and was there an ethical review?",
            "The sources `phantom`, `release` and `cactus` show a phantom: no person was scanned. "
            "For `tracked`, whoever imports recordings of people answers for consent and review.",
        ),
    )


def _preprocessing(
    manifest: Mapping[str, Any], rai: Mapping[str, Any]
) -> tuple[tuple[str, str], ...]:
    report = manifest["report"]
    return (
        ("Was the data preprocessed?", _joined(rai["rai:dataPreprocessingProtocol"])),
        ("How was it labelled?", str(rai["rai:dataAnnotationProtocol"])),
        (
            "Was anything refused?",
            f"{report['refused_frames']:,} frames refused, {report['flagged']:,} inputs flagged; "
            "`import_report.parquet` gives each with its reason.",
        ),
    )


def _uses(rai: Mapping[str, Any]) -> tuple[tuple[str, str], ...]:
    return (
        ("What is it for, and what not?", _joined(rai["rai:dataUseCases"])),
        ("What limits its use?", _joined(rai["rai:dataLimitations"])),
        ("What could go wrong?", str(rai["rai:dataSocialImpact"])),
    )


def _distribution(manifest: Mapping[str, Any]) -> tuple[tuple[str, str], ...]:
    return (
        ("Under what licence?", manifest_card(manifest).rights),
        (
            "How is it distributed?",
            "As a folder of Parquet files that `datasets` reads, built from its recipe by one "
            "command or fetched from a hub under its tag "
            f"`{manifest.get('tag', manifest['version'])}`. `croissant.json`, where present, "
            "describes it for other readers.",
        ),
    )


def _joined(value: Any) -> str:
    return value if isinstance(value, str) else " ".join(value)
