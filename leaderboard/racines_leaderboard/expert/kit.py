"""A study's kit: images under blind names, what a rater's page needs, and the sealed key.

    FOLDER/images/0001.png ...   the images, all of one size and date
    FOLDER/kit.json              names, views, scale, instructions; nothing of the answers
    FOLDER/key.json              the answers; not for raters

`kit.json` holds the SHA-256 of key and images, and its own digest, which every rating repeats: none
can be changed once ratings exist.
"""

import functools
import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from racines_data.errors import RacinesError
from racines_data.files import sha256_file
from racines_data.views import VIEW_TITLES
from racines_leaderboard.records.schema import read_json

KIT, KEY, IMAGES = "kit.json", "key.json", "images"
INSTRUCTIONS = (
    "You will see ultrasound images one by one. Say of each which standard view it shows, or that "
    "it shows none. Then grade it from 1, poor, to 10, excellent, by two criteria: completeness, "
    "are the structures of the view in the image, and clarity, can they be told apart. An image of "
    "no view is graded 0. Judge each image by itself. Some come twice. An answer cannot be changed."
)
PREFACE = (
    "The images come from a simulated or artificial block, or from programs that imitate it. "
    "There may be no valves. Research software, not a medical device."
)


@dataclass(frozen=True)
class Kit:
    """What a rater may see of a study."""

    folder: Path
    document: dict[str, Any]

    @classmethod
    def open(cls, folder: Path | str) -> "Kit":
        """Read a kit; RacinesError if none is there, or `kit.json` was changed."""
        folder = Path(folder)
        document = read_json(folder / KIT, "expert-kit")
        if _digest(document) != document["digest"]:
            raise RacinesError(f"{folder / KIT}: digest: the file was changed after it was made")
        return cls(folder, document)

    @property
    def digest(self) -> str:
        """The kit's name in every rating of it."""
        return self.document["digest"]

    @property
    def blocks(self) -> list[list[str]]:
        """Three blocks of image names; an image and its repeat lie in the first and the last."""
        return self.document["blocks"]

    @functools.cached_property
    def images(self) -> list[str]:
        """All image names, sorted."""
        return sorted(image for block in self.blocks for image in block)

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the views to choose from; the last says that there is none."""
        return tuple(view["name"] for view in self.document["views"])

    def image_path(self, image: str) -> Path:
        """Return the file of an image; one that the kit does not have raises RacinesError."""
        if image not in self.images:
            raise RacinesError(f"{self.folder}: no image {image!r}")
        return self.folder / IMAGES / f"{image}.png"

    def fault(self, image: str, view: str, grade: int) -> str | None:
        """Say what is wrong with an answer, or None."""
        scale = self.document["grades"]
        if isinstance(grade, bool) or not isinstance(grade, int | float) or grade % 1:
            return f"image {image}: grade {grade!r}: give a whole number"
        if image not in self.images:
            return f"image {image!r} is not of this kit"
        if view not in self.labels:
            return f"image {image}: view {view!r} is none of {', '.join(self.labels)}"
        if view == self.labels[-1]:
            right = grade == scale["no_view"]
            return None if right else f"image {image}: grade {grade}: {view} is graded 0"
        if not scale["lowest"] <= grade <= scale["highest"]:
            reach = f"{scale['lowest']} to {scale['highest']}"
            return f"image {image}: grade {grade}: a view is graded {reach}"
        return None

    def check_images(self) -> None:
        """Check that none of the images is missing or differs from those of the making."""
        paths = [self.image_path(image) for image in self.images]
        if missing := [path.name for path in paths if not path.is_file()]:
            raise RacinesError(f"{self.folder / IMAGES}: missing: {', '.join(missing[:5])}")
        if _images_sha256(paths) != self.document["images_sha256"]:
            where = self.folder / IMAGES
            raise RacinesError(f"{where}: images were changed after the kit was made")

    def read_key(self, path: Path | None = None) -> dict[str, Any]:
        """Return the answers by the sealed key, in the kit's folder or where it was kept."""
        path = path or self.folder / KEY
        if not path.is_file():
            raise RacinesError(f"{path}: no key; name the place where it was kept with --key")
        if sha256_file(path) != self.document["key_sha256"]:
            raise RacinesError(f"{path}: not the key that {self.folder / KIT} was sealed with")
        return read_json(path, "expert-key")


def sealed_document(
    labels: Sequence[str], blocks: list[list[str]], images: list[Path], key: Path
) -> dict[str, Any]:
    """Return the content of `kit.json`, which holds the hashes of the images and of the key."""
    document = {
        "schema": "racines.expert-kit/1",
        "preface": PREFACE,
        "instructions": INSTRUCTIONS,
        "views": [{"name": name, "title": VIEW_TITLES.get(name, name)} for name in labels],
        "grades": {"no_view": 0, "lowest": 1, "highest": 10},
        "blocks": blocks,
        "images_sha256": _images_sha256(images),
        "key_sha256": sha256_file(key),
    }
    return document | {"digest": _digest(document)}


def _digest(document: dict[str, Any]) -> str:
    """Return the SHA-256 of a kit's document without its own digest."""
    content = {key: value for key, value in document.items() if key != "digest"}
    text = json.dumps(content, sort_keys=True, ensure_ascii=False, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def _images_sha256(paths: list[Path]) -> str:
    """Return one SHA-256 over all images: one an image would show which are repeats."""
    digest = hashlib.sha256()
    for path in sorted(paths):
        digest.update(path.name.encode() + bytes.fromhex(sha256_file(path)))
    return digest.hexdigest()
