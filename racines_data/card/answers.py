"""What is said of a dataset where it depends on what it is: simulated, of a phantom, of a user's.

Everything is read from the manifest: what was measured, how it is split, whose frames they are.
Nothing is claimed of recordings that only whoever made them can know.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from racines_data.manifest import added_configs, is_turned
from racines_data.sources.base import SIMULATED, is_own, manifest_card

BLOCKS = ("release", "cactus")
"""Sources whose frames show a manufactured phantom; nobody was scanned."""
_SPLIT_HERE = (*SIMULATED, *BLOCKS, "tracked", "table")
"""Sources of this package whose units name no split of their own, so that the build deals them."""
_SWEEPS = {
    "cactus": "in runs of images without poses",
    "tracked": "in segments of freehand sweeps",
    "table": "in sweeps",
}
_KINDS = ("force", "torque", "position", "rotation", "view", "grade")
_RISK = "The risk is overconfidence: a system that does well here has been shown to do well on "


def is_simulated(manifest: Mapping[str, Any]) -> bool:
    """Return whether a machine made the frames."""
    return manifest_card(manifest).simulated


def is_of_users(manifest: Mapping[str, Any]) -> bool:
    """Return whether frames are recordings of which only their makers know what was scanned."""
    return not is_simulated(manifest) and manifest["source"] not in BLOCKS


def measured(manifest: Mapping[str, Any]) -> set[str]:
    """Return what is known of any frame: of `force`, `torque`, `position`, …, `view`, `grade`.

    Of an older manifest, which has no statistics, what its source is known to have.
    """
    found = manifest.get("statistics")
    if found is None:
        poses = {"position", "rotation"} if manifest.get("poses", True) else set()
        wrench = {"force", "torque"} if manifest["source"] in ("phantom", "release") else set()
        return poses | wrench | ({"view"} if manifest_card(manifest).labelled else set())
    known = {name.partition("_")[0] for name in found["parameters"]}
    if any(sum(each.values()) > each["unknown"] for each in found["views"].values()):
        known.add("view")
    if any(sum(each["counts"]) for each in found["grades"].values()):
        known.add("grade")
    return known


def contents(manifest: Mapping[str, Any]) -> str:
    """Return what each image comes with, in words."""
    known = measured(manifest)
    has = ["the probe's pose"] * ("position" in known)
    has += [kind for kind in ("force", "torque") if kind in known]
    if is_turned(manifest):
        has += ["the phase of the beat"] * (manifest["turns"]["phases"] > 1)
        has += ["the angle of its turn"]
    has += ["the view it shows"] * ("view" in known) + ["its grade"] * ("grade" in known)
    return _listed(has or ["the name of its trajectory"])


def _aims(manifest: Mapping[str, Any]) -> str:
    """Return what can be trained and scored on it."""
    known = measured(manifest)
    given = "pose and force" if "force" in known else "pose"
    aims = [f"image generators conditioned on the probe's {given}"] * ("position" in known)
    graders = [kind for kind in ("view", "grade") if kind in known]
    aims += [f"{' and '.join(graders)} classifiers"] * bool(graders)
    aims += ["scanning agents"] * ("position" in known)
    return _listed(aims or ["image models"])


def _listed(items: Sequence[str]) -> str:
    """Return items as a list in a sentence; they may hold an `and` of their own."""
    *others, last = items
    return f"{', '.join(others)}, and {last}" if others else last


def introduction(manifest: Mapping[str, Any]) -> str:
    """Return what the card begins with."""
    sweeps = "in sweeps towards standard views and at random"
    if is_turned(manifest):
        sweeps = "in turns of the probe about the apex"
    elif is_of_users(manifest) or manifest["source"] in _SWEEPS:
        sweeps = _SWEEPS.get(manifest["source"], "in trajectories")
    return (
        f"Ultrasound frames for robotic scanning: each image with {contents(manifest)}, {sweeps}. "
        f"For training and scoring of {_aims(manifest)}."
    )


def uses(manifest: Mapping[str, Any]) -> str:
    """Return what it is for, and what not."""
    where = "with the tools of RACINES" if is_of_users(manifest) else "on the RACINES leaderboard"
    return (
        f"Training and scoring of {_aims(manifest)}, {where}. Not for: diagnosis, guidance of "
        "examinations of people, or claims about clinical performance. Research software, not a "
        "medical device."
    )


def impact(manifest: Mapping[str, Any]) -> str:
    """Return what it may do to people."""
    if is_of_users(manifest):
        heart = "one heart only" if is_turned(manifest) else "these recordings only"
        return (
            "Meant to hold methods of robotic ultrasound against recordings. "
            f"{_RISK}{heart}; of other people it says nothing. Where persons were scanned, a "
            "second risk is use beyond what they agreed to: licence and statement on consent, "
            "where they were given, stand on the card."
        )
    what = "a simulation only" if is_simulated(manifest) else "a manufactured phantom only"
    return (
        "Meant to make research on robotic ultrasound reproducible without access to a robot or "
        f"to patients' data. {_RISK}{what}."
    )


def purpose(manifest: Mapping[str, Any]) -> str:
    """Return for what purpose it was made."""
    whole = (
        f"each frame comes with {contents(manifest)}. The format follows the RACINES dataset of "
        "the paper that introduced the task."
    )
    if is_of_users(manifest):
        return (
            "What the recordings were made for is their makers' to say. They were imported so that "
            f"{_aims(manifest)} can be trained, scored and compared on them: {whole}"
        )
    return f"To let {_aims(manifest)} be trained, scored and compared by anyone: {whole}"


def model(manifest: Mapping[str, Any]) -> str:
    """Return whether a model made the frames, of the config `frames` and of those added to it."""
    patients = [f"`{name}`" for name in added_configs(manifest)]
    added = f" Those of {' and '.join(patients)} are: by simulated patients in "
    added = f"{added}`racines_data/phantom`." if patients else ""
    card = manifest_card(manifest)
    if not card.simulated:
        return f"No: no frame of the config `frames` is simulated.{added}"
    if not is_own(card, manifest["source"]):
        return f"Yes, of another package; see its documentation.{added}"
    return (
        "Yes: a parametric heart in a gel block, or an anatomy of one's own where it is named "
        "under Collection, its acoustics and its contact with a probe, all in "
        "`racines_data/phantom`."
    )


def instance(manifest: Mapping[str, Any]) -> str:
    """Return what an instance consists of."""
    known = measured(manifest)
    absent = [kind for kind in _KINDS if kind not in known]
    lacks = f" Nowhere known, and null: {', '.join(absent)}." if absent else ""
    return (
        f"An image of 128×128 gray pixels, with {contents(manifest)}; and the columns of the table "
        f"above, null where nothing was measured.{lacks}"
    )


def relations(manifest: Mapping[str, Any]) -> str:
    """Return how rows are related to one another."""
    if is_turned(manifest):
        return (
            "The rows of a trajectory are the phases of one turn, all at one pose: no time and no "
            "action lies between them. Turns at near angles are alike; `turn_angle` and "
            "`train_angle` say how near."
        )
    if not manifest.get("poses", True):
        return (
            "Neighbouring rows of a trajectory are images whose files follow one another, often "
            "near-copies; `trajectory`, `frame` and `session` say so."
        )
    return (
        "Neighbouring rows of a trajectory are consecutive frames of one sweep, hence near-copies; "
        "`trajectory`, `frame` and `session` say so. Where the commanded velocity is known, two "
        "neighbouring rows are a transition (state, action, next state)."
    )


def split_by(manifest: Mapping[str, Any]) -> str:
    """Return by what the config `frames` is split.

    Views are strata only where the build deals the splits, and there is more than one target: a
    canonical frame is kept of each.
    """
    if is_turned(manifest):
        return "angle of the turn"
    several = len(manifest.get("canonical", ())) > 1 and manifest["source"] in _SPLIT_HERE
    return "trajectory" + ", stratified by target view" * several


def splits(manifest: Mapping[str, Any]) -> str:
    """Return which splits are recommended, and what they are worth."""
    leak = "Do not split by frame: the near-copies would leak."
    if is_turned(manifest):
        blocks = "one wide block" if manifest["turns"]["split"] == "gap" else "narrow blocks"
        return (
            f"Yes, `train`, `validation` and `test`, by angle of the turn: whole turns, {blocks} "
            "of which are held out. Tell results by `train_angle`, the angle to the nearest "
            f"training turn. {leak}"
        )
    cut = (
        " Trajectories are parts of longer sweeps, so that frames on both sides of a cut are "
        "neighbours in time, and scores are optimistic."
    )
    return (
        "Yes, `train`, `validation` and `test`, each trajectory wholly in one: by "
        f"{split_by(manifest)}.{cut * _is_cut(manifest)} {leak}"
    )


def _is_cut(manifest: Mapping[str, Any]) -> bool:
    """Return whether trajectories were cut from longer sweeps, as far as the recipe tells."""
    place = {"tracked": "config", "table": "mapping"}.get(manifest["source"])
    if place is None:
        return manifest["source"] == "cactus"
    settings = manifest.get("recipe", {}).get("settings", {})
    return settings.get(place, {}).get("segments", 1) > 1


def people(manifest: Mapping[str, Any]) -> str:
    """Return whether people were involved, and who answers for it."""
    if is_simulated(manifest):
        return "No: the frames are simulated, and no person was scanned."
    if not is_of_users(manifest):
        return "No person was scanned: the frames show a manufactured phantom."
    return (
        "Where people were scanned, whoever imported the recordings answers for consent and "
        "review. What was stated of it at import stands under Composition, with the personal data."
    )


def software(manifest: Mapping[str, Any], name: str) -> str:
    """Return what made the dataset; `name` is the source as the page shows it."""
    command = "build" if is_simulated(manifest) else "import"
    return (
        f"`racines data {command}`, source {name}; version, settings, seed and inputs are the "
        "recipe in `manifest.json`."
    )


def maintenance(manifest: Mapping[str, Any]) -> str:
    """Return who maintains it, and how versions are told apart."""
    digests = "Each version has a content digest and a recipe digest, and every file a sha256."
    if is_of_users(manifest):
        return (
            f"Whoever imported it maintains it. The version is that of its source. {digests} "
            "Recordings that are corrected are imported again, and both digests change."
        )
    return (
        f"Versions are semantic and tagged `SOURCE-vX.Y.Z`; a tag is never moved. {digests} A "
        "fault found is corrected in a new version and named in the changelog; old versions stay "
        "available."
    )


def distribution(manifest: Mapping[str, Any], tag: str) -> str:
    """Return how it is distributed."""
    made = f"built from its recipe by one command or fetched from a hub under its tag `{tag}`"
    if not is_simulated(manifest):
        made = (
            "imported from the recordings or, where their licence permits, fetched from a hub "
            f"under its tag `{tag}`"
        )
    return (
        f"As a folder of Parquet files that `datasets` reads, {made}. `croissant.json`, where "
        "present, describes it for other readers."
    )
