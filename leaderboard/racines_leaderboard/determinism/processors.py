"""The phantom's canonical frames as several processors drew them, and how far they differ.

    poses on record ──> drawn here ──┐
    sets on record, by processor ────┴──> compared pair by pair, against `validate.canonical`

A set is what one kind of processor drew under one instruction set of PyTorch's. PyTorch chooses the
instruction set once a process: `ATEN_CPU_CAPABILITY=avx2 racines study processors` is another one.
The file keeps the poses, the first set whole, and of the others how they differ from it.
"""

import hashlib
import io
import json
import zlib
from dataclasses import asdict, dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
import torch

from racines_data import processor
from racines_data.errors import RacinesError
from racines_data.files import write_atomic
from racines_data.geometry import Pose, pose_to_parameters
from racines_data.phantom import PHANTOM_VERSION, Phantom, PhantomConfig
from racines_data.phantom.config import heart_config
from racines_data.randomness import sample_seeds, uniform
from racines_data.tables import markdown_table
from racines_data.validate.canonical import BEYOND, LEVELS, SHARE, compare

SCHEMA = "racines.canonical/1"
RECORD = Path(__file__).with_name("canonical.npz")
SCENES = {
    "heart": PhantomConfig(),
    "heart 3": heart_config(PhantomConfig(), 3),
    "heart 7": heart_config(PhantomConfig(), 7),
    "abdomen": PhantomConfig(anatomy="abdomen"),
}
POSES = 12  # of each scene
_REACH = torch.tensor([0.010, 0.010, 0.003, 0.15, 0.15, 0.3])  # about a view's pose: m, rad


@dataclass(frozen=True)
class Drawing:
    """The canonical frames as one processor drew them."""

    cpu: str
    """Name, family and model: virtual machines give no more than a maker's name."""
    instructions: str
    """PyTorch's choice: DEFAULT, AVX2 or AVX512 on x86."""
    torch: str
    """Version of PyTorch."""
    images: np.ndarray
    """(N, 128, 128) uint8."""

    @property
    def kind(self) -> tuple[str, str]:
        """What tells two sets apart."""
        return self.cpu, self.instructions

    @property
    def name(self) -> str:
        """The kind in a line."""
        return f"{self.cpu}, {self.instructions}"


@dataclass(frozen=True)
class Record:
    """Poses, scene by scene, and the sets that were drawn of them."""

    parameters: np.ndarray
    """(N, 12) float32: the poses, in the order of `SCENES`; forces are 0."""
    drawings: tuple[Drawing, ...] = ()

    def with_drawing(self, drawing: Drawing) -> "Record":
        """Return the record with a set more, in the place of one of the same kind."""
        kept = tuple(each for each in self.drawings if each.kind != drawing.kind)
        return replace(self, drawings=(*kept, drawing))


def choose_poses() -> Record:
    """Return a record of `POSES` poses near the views of each scene, and no set yet."""
    found = []
    for number, config in enumerate(SCENES.values()):
        phantom = Phantom(config)
        targets = [phantom.target(phantom.views[i % len(phantom.views)]) for i in range(POSES)]
        pose = Pose(*(torch.cat(parts) for parts in zip(*targets, strict=True)))
        about = 2.0 * uniform(sample_seeds(number, POSES), 6, 77) - 1.0
        parameters = pose_to_parameters(pose)
        parameters[:, 6:] += _REACH * about
        found.append(parameters)
    return Record(torch.cat(found).to(torch.float32).numpy())


def draw(record: Record) -> Drawing:
    """Draw the poses of a record on this processor, with one thread; a row's seed is its number."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        images, parameters = [], torch.from_numpy(record.parameters).split(POSES)
        for number, (config, rows) in enumerate(zip(SCENES.values(), parameters, strict=True)):
            seeds = torch.arange(POSES) + POSES * number
            images.append(Phantom(config).generate(rows, seeds))
    finally:
        torch.set_num_threads(threads)
    chosen = torch.backends.cpu.get_cpu_capability()
    return Drawing(_processor(), chosen, torch.__version__, torch.cat(images).numpy())


def _processor() -> str:
    told = processor.told()
    parts = [
        f"{key.removeprefix('cpu ')} {told[key]}" for key in ("cpu family", "model") if key in told
    ]
    return processor.processor() + (f" ({', '.join(parts)})" if parts else "")


def read_record(path: Path = RECORD) -> Record:
    """Read poses and sets.

    Raises:
        RacinesError: no record, one of another phantom, or a damaged one.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            told = json.loads(str(file["told"]))
            first = file["images"]
            drawings = [
                Drawing(**each["by"], images=first + file[f"change_{number}"])
                for number, each in enumerate(told["drawings"])
            ]
            parameters = file["parameters"]
    except FileNotFoundError as error:
        raise RacinesError(f"{path}: no canonical frames here; install racines anew") from error
    except (OSError, ValueError, KeyError, TypeError, EOFError, BadZipFile, zlib.error) as error:
        raise RacinesError(f"{path}: not canonical frames ({error}); get it anew") from error
    if (told["schema"], told["phantom"], told["scenes"]) != (SCHEMA, PHANTOM_VERSION, [*SCENES]):
        raise RacinesError(
            f"{path}: of phantom {told['phantom']} and scenes {', '.join(told['scenes'])}; this "
            f"code draws phantom {PHANTOM_VERSION}: {', '.join(SCENES)}"
        )
    for drawing, each in zip(drawings, told["drawings"], strict=True):
        if _sha256(drawing) != each["sha256"]:
            raise RacinesError(f"{path}: frames of {drawing.name} are damaged; get it anew")
    return Record(parameters, tuple(drawings))


def write_record(record: Record, path: Path) -> None:
    """Write poses and sets, compressed; what is there is replaced when the new file is whole."""
    first = record.drawings[0].images
    told = {
        "schema": SCHEMA,
        "phantom": PHANTOM_VERSION,
        "scenes": [*SCENES],
        "drawings": [{"by": _by(each), "sha256": _sha256(each)} for each in record.drawings],
    }
    # Differences wrap around 256, as uint8 does: the sum is exact, and zeros take no room.
    changes = {f"change_{i}": each.images - first for i, each in enumerate(record.drawings)}
    arrays: dict[str, Any] = {"parameters": record.parameters, "images": first, **changes}
    buffer = io.BytesIO()
    np.savez_compressed(buffer, told=np.array(json.dumps(told)), **arrays)
    write_atomic(path, buffer.getvalue())


def _by(drawing: Drawing) -> dict[str, str]:
    return {name: getattr(drawing, name) for name in ("cpu", "instructions", "torch")}


def _sha256(drawing: Drawing) -> str:
    return hashlib.sha256(drawing.images.tobytes()).hexdigest()


def compare_all(record: Record, here: Drawing | None = None) -> dict[str, Any]:
    """Hold the frames drawn here against each set, and the sets against one another."""
    pairs = [] if here is None else [(here, each) for each in record.drawings]
    pairs += combinations(record.drawings, 2)
    rows = []
    for one, other in pairs:
        found = compare(one.images, other.images)
        names = {"one": _by(one), "other": _by(other), "here": one is here}
        rows.append({**names, **asdict(found), "holds": found.holds})
    return {
        "schema": "racines.processors/1",
        "phantom": PHANTOM_VERSION,
        "frames": len(record.parameters),
        "tolerance": {"levels": LEVELS, "beyond_in_a_frame": BEYOND, "share": SHARE},
        "here": None if here is None else {**_by(here), "sha256": _sha256(here)},
        "pairs": rows,
        "holds": all(row["holds"] for row in rows),
    }


def processors_markdown(report: dict[str, Any]) -> str:
    """Return the comparison as a Markdown table."""

    def name(by: dict[str, str]) -> str:
        return f"{by['cpu']}, {by['instructions']}"

    head = ("drawn by", "and by", "greatest difference", "pixels", "by more than 1", "holds")
    rows = [
        (
            f"{name(row['one'])} (here)" if row["here"] else name(row["one"]),
            name(row["other"]),
            f"{row['levels']} gray levels",
            f"{row['differing']} of {row['pixels']}",
            f"{row['beyond']}",
            "yes" if row["holds"] else "NO",
        )
        for row in report["pairs"]
    ]
    return markdown_table(head, rows)
