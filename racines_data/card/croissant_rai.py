"""What a user of the data should know before using it, in the Croissant RAI 1.0 vocabulary."""

from collections.abc import Mapping
from typing import Any

_COLLECTION = {
    "phantom": (
        "Simulated: a seeded acquisition by a simulated robot arm that moves a phased-array probe "
        "over a simulated cardiac block in joystick-like sweeps (approach, overshoot, correction, "
        "dwell, leave) and random scans. Images, forces and torques come from models of acoustics "
        "and contact. No frame comes from a scanner, and no person took part."
    ),
    "release": (
        "The published RACINES recordings, imported: an operator moved a UR5e arm that holds a "
        "phased-array probe over a CAE Blue Phantom cardiac block."
    ),
    "cactus": (
        "The published CACTUS images, imported: frames of a cardiac phantom with view and grade, "
        "without poses."
    ),
    "tracked": (
        "Freehand sweeps with a tracked probe, imported; poses are those of the probe marker."
    ),
}
_TYPE = {
    "phantom": ["Software Collection"],
    "release": ["Direct measurement"],
    "cactus": ["Direct measurement"],
    "tracked": ["Direct measurement"],
}
_ANNOTATION = {
    "phantom": (
        "View and grade (0-10) are computed from the true pose and the anatomy: which of the "
        "view's structures lie in the plane and the sector, and how clearly. This oracle stands in "
        "for an expert and is not one."
    ),
    "release": "The recordings name a target view a folder and have no grades.",
    "cactus": "View and grade as published with the images; see the CACTUS publication.",
    "tracked": "None: there are no views and no grades.",
}
_BIASES = {
    "phantom": (
        "One simulated block at nominal size is the `frames` config: anatomy, pathology, body "
        "habitus and breathing do not vary. `multi_phantom`, where present, varies size, wall and "
        "orientation within adult ranges, not disease. One probe and one robot. Sweeps imitate one "
        "style of operator."
    ),
    "release": "One manufactured block and one arm; anatomy and pathology do not vary.",
    "cactus": "A manufactured heart; classes and grades in the shares its authors chose.",
    "tracked": "As the recordings; a few sweeps of one subject are the rule.",
}
_LIMITATIONS = {
    "phantom": (
        "Simulated images differ from real echo; docs/phantom.md gives the measured distance. "
        "Neighbouring frames of a sweep are near-copies: split by trajectory only. Never to be "
        "mixed with, or presented as, recordings of the real block."
    ),
    "release": (
        "A phantom is not a patient. Neighbouring frames of a sweep are near-copies: split by "
        "trajectory only. There are no grades."
    ),
    "cactus": "A phantom is not a patient. There are no poses or forces.",
    "tracked": (
        "Segments of one sweep stand as trajectories, so scores on the splits are optimistic. "
        "There are no forces, views or grades, and the marker's pose is not the image plane's."
    ),
}
_PERSONAL = {
    "phantom": "None: simulated; there is no subject.",
    "release": "None: images of a manufactured phantom.",
    "cactus": "None: images of a manufactured phantom.",
    "tracked": (
        "Depends on the recordings: whoever imports sweeps of persons is answerable for consent "
        "and de-identification. Only pixels, poses and times are kept; other header fields are not."
    ),
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


def rai_fields(manifest: Mapping[str, Any]) -> dict[str, Any]:
    """Return the `rai:` properties of a dataset, by its source and its manifest."""
    source = manifest["source"]
    other = "A source of another package; see its documentation."
    grader = manifest.get("annotation", {}).get("grader")
    tools = [f"RACINES grader, weights sha256 {grader}"] if grader else []
    return {
        "rai:dataCollection": _COLLECTION.get(source, other),
        "rai:dataCollectionType": _TYPE.get(source, ["Others"]),
        "rai:dataCollectionMissingData": _missing(manifest),
        "rai:dataCollectionRawData": f"Recipe sha256 {manifest['recipe_digest']}, in the manifest.",
        "rai:dataPreprocessingProtocol": [_PREPROCESSING],
        "rai:dataAnnotationProtocol": _ANNOTATION.get(source, other),
        "rai:machineAnnotationTools": tools,
        "rai:dataUseCases": [_USES],
        "rai:dataBiases": [_BIASES.get(source, other)],
        "rai:dataLimitations": [_LIMITATIONS.get(source, other)],
        "rai:dataSocialImpact": _IMPACT,
        "rai:personalSensitiveInformation": [_PERSONAL.get(source, other)],
        "rai:dataReleaseMaintenancePlan": _MAINTENANCE,
    }


def _missing(manifest: Mapping[str, Any]) -> str:
    report = manifest.get("report", {})
    refused, flagged = report.get("refused_frames", 0), report.get("flagged", 0)
    return (
        f"Measurements that are not known are null. {refused} frames were refused and {flagged} "
        "inputs flagged; import_report.parquet gives each with its reason."
    )
