"""What a user of the data should know before using it, in the Croissant RAI 1.0 vocabulary."""

from collections.abc import Mapping
from typing import Any

from racines_data.sources.card import manifest_card

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


def rai_fields(manifest: Mapping[str, Any]) -> dict[str, Any]:
    """Return the `rai:` properties of a dataset, by its source and its manifest."""
    card = manifest_card(manifest)
    grader = manifest.get("annotation", {}).get("grader")
    tools = [f"RACINES grader, weights sha256 {grader}"] if grader else []
    return {
        "rai:dataCollection": card.collection,
        "rai:dataCollectionType": [card.collection_type],
        "rai:dataCollectionMissingData": _missing(manifest),
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


def _missing(manifest: Mapping[str, Any]) -> str:
    report = manifest.get("report", {})
    refused, flagged = report.get("refused_frames", 0), report.get("flagged", 0)
    return (
        f"Measurements that are not known are null. {refused} frames were refused and {flagged} "
        "inputs flagged; import_report.parquet gives each with its reason."
    )
