"""Phantoms of one's own on disk, as `racines phantom` writes them: a folder stands for an organ.

    NAME/phantom.json          what it is, where it comes from, tissues, landmarks, views, place
    NAME/phantom.safetensors   parts by voxel and, of a heart, how it moves
    NAME/README.md             its card

A folder is named by its path, or by its name where it lies in `data/phantoms`.
"""

import hashlib
import json
from pathlib import Path
from typing import Any, NamedTuple

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.files import sha256_file
from racines_data.views import ANATOMIES

SCHEMA = "racines.own-anatomy/1"
TOLD, TENSORS, CARD = "phantom.json", "phantom.safetensors", "README.md"
FOLDER = Path("data/phantoms")
"""Where phantoms lie that are named without a path."""


class Saved(NamedTuple):
    """A phantom of one's own, read and checked."""

    folder: Path
    told: dict[str, Any]
    """`phantom.json`."""
    tensors: dict[str, Tensor]
    """`labels` (X, Y, Z) uint8, a part's number from 1 up and 0 around them, and those of a heart's
    motion (see `racines_data.own.warp`)."""

    def number_at(self, points: Tensor) -> Tensor:
        """Return the (M,) int64 numbers of the parts at (M, 3) points of the organ frame, m."""
        labels = self.tensors["labels"]
        inverse = torch.tensor(self.told["grid"]["to_index"], dtype=torch.float64)
        place = points.double() * 1e3 @ inverse[:, :3].T + inverse[:, 3]
        index = (place + 0.5).floor().long()
        size = torch.tensor(labels.shape)
        inside = ((index >= 0) & (index < size)).all(1)
        index = torch.where(inside.unsqueeze(1), index, 0)
        return labels[tuple(index.unbind(1))].long() * inside

    def paint(self, points: Tensor) -> Tensor:
        """Return the (M,) int64 tissues at (M, 3) points of the organ frame, m."""
        tissues = torch.tensor([0, *(part["tissue"] for part in self.told["parts"])])
        return tissues[self.number_at(points)]


def find_saved(name: str) -> Path | None:
    """Return the folder of a phantom of one's own that a name or path stands for; None for others.

    A registered anatomy is what its name says, whatever folders lie about.

    Raises:
        RacinesError: a path that leads to no such folder.
    """
    return None if name in ANATOMIES.names() else saved_folder(name)


def saved_folder(name: str) -> Path | None:
    """Return the folder of a phantom of one's own by its path or name; None where there is none.

    Raises:
        RacinesError: a path that leads to no such folder.
    """
    for folder in (Path(name), FOLDER / name):
        if (folder / TOLD).is_file():
            return folder
    if "/" in name or "\\" in name or Path(name).is_dir():
        raise RacinesError(
            f"anatomy {name}: no folder of a phantom ({TOLD}): make one with racines phantom "
            "from-mesh or from-labels"
        )
    return None


def read_saved(folder: Path) -> Saved:
    """Read a phantom of one's own.

    Raises:
        RacinesError: no such file, another schema, or tensors that are not those it was made with.
    """
    path, tensors = folder / TOLD, folder / TENSORS
    again = "make it again with racines phantom"
    if not path.is_file():
        raise RacinesError(f"{path}: no such file: {again}")
    try:
        told = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise RacinesError(f"{path}: not valid JSON ({error}): {again}") from error
    if not isinstance(told, dict) or told.get("schema") != SCHEMA:
        raise RacinesError(f"{path}: schema is not {SCHEMA}: {again}")
    if digest_of(told) != told.get("digest"):
        raise RacinesError(f"{path}: was changed after it was made (digest): {again}")
    if not tensors.is_file() or sha256_file(tensors) != told["tensors"]["sha256"]:
        raise RacinesError(f"{tensors}: is not the file that {TOLD} names (sha256): {again}")
    try:
        return Saved(folder, told, load_file(tensors))
    except (OSError, SafetensorError) as error:
        raise RacinesError(f"{tensors}: {error}: {again}") from error


def digest_of(told: dict[str, Any]) -> str:
    """Return the sha256 of all that `phantom.json` tells but of its digest."""
    rest = {name: value for name, value in told.items() if name != "digest"}
    return hashlib.sha256(json.dumps(rest, sort_keys=True).encode()).hexdigest()


def provenance(name: str) -> dict[str, Any] | None:
    """Return what records say of a phantom of one's own; None for any other anatomy.

    Raises:
        RacinesError: as `find_saved` and `read_saved`.
    """
    folder = find_saved(name)
    if folder is None:
        return None
    return provenance_of(read_saved(folder).told)


def provenance_of(told: dict[str, Any]) -> dict[str, Any]:
    """Return of `phantom.json` what records say."""
    return {name: told[name] for name in ("name", "digest", "source", "licence", "synthetic")}
