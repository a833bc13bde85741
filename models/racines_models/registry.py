"""Generators by entry point of the group `racines.generators`, `module:Class`, or file."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from racines_data.errors import RacinesError
from racines_data.files import sha256_file
from racines_data.imaging import ImageSource
from racines_data.plugins import Plugins
from racines_data.store.frames import FrameStore
from racines_models.protocol import Generator
from racines_models.provenance import weights_sha256
from racines_models.published.places import WEIGHTS, own_or_published
from racines_models.training.checkpoint import repeat_folders

GENERATORS = Plugins(
    "generator",
    "racines.generators",
    ("name", "Config", "card", "fit", "generate", "save", "load"),
    "module:Class, FILE.onnx or FILE.parquet",
)
RUNS = Path("models/runs")
"""Where trained generators lie, each in a folder of its name."""
PATIENTS = "patients"
"""The tier of still patients, whom a generator meets by their scouts."""
_NAME = re.compile(r"[A-Za-z0-9][\w.-]*", re.ASCII)
FILES = (".onnx", ".parquet")
"""Endings of the files that are generators."""


def generator_names() -> list[str]:
    """Return the names that installed packages register, sorted."""
    return list(GENERATORS.names())


def generator_class(spec: str) -> type[Generator]:
    """Return the class of a registered name or of `module:Class`, if it is a generator's.

    Raises:
        RacinesError: no such generator, or a class whose name is no folder's or another's.
    """
    found = GENERATORS.load(spec)
    if spec in GENERATORS.names():
        return found
    name = found.name
    if not isinstance(name, str) or not _NAME.fullmatch(name):
        raise RacinesError(f"{spec}: name {name!r}: its folder's: give one of a-z A-Z 0-9 . _ -")
    if name in GENERATORS.names() and GENERATORS.load(name) is not found:
        raise RacinesError(f"{spec}: name {name!r} is a registered generator's: give another")
    return found


def load_generator(spec: str, run_dir: Path | str, device: str = "cpu") -> Generator:
    """Return the fitted generator that a run left in `run_dir`, if its model is there."""
    return generator_class(spec).load(Path(run_dir), device)


def open_generator(
    spec: str,
    folder: Path | str | None = None,
    device: str = "cpu",
    *,
    store: FrameStore | None = None,
    split: str | None = None,
) -> ImageSource:
    """Return the generator that a spec names: a name, `module:Class`, an ONNX or a Parquet file.

    Args:
        spec: A registered name, `module:Class`, `FILE.onnx` or `FILE.parquet`.
        folder: Of a name or class: the folder of its run; default `models/runs/NAME`.
        device: `cpu` or `cuda`.
        store: Of a Parquet file, which has `draw_frames` alone: the dataset that it must be for.
        split: Of a Parquet file: the split that it must be for.

    Raises:
        RacinesError: unknown, absent or refused, by name or file.
    """
    if not is_file(spec):
        return load_generator(spec, run_folder(spec, folder), device)
    if folder is not None:
        raise RacinesError(f"{spec} is a file: it has no run folder ({folder}); give one of them")
    if Path(spec).suffix.lower() == ".onnx":
        from racines_models.exchange.onnx.generator import OnnxGenerator

        return OnnxGenerator(Path(spec), device)
    if store is None:
        raise RacinesError(
            f"{spec}: a predictions file holds the images of some frames and draws no other pose: "
            "score it, or name a generator or an ONNX file"
        )
    from racines_models.exchange.predictions.file import Predictions

    predictions: Any = Predictions(Path(spec), store, split)
    return predictions


def open_runs(
    spec: str, folder: Path | str | None = None, published: Sequence[Path] = (), **opened: Any
) -> list[ImageSource]:
    """Return the generator that a spec names (see `open_generator`), then its further seeds.

    First those of its run, then those in `published` folders.
    """
    first = open_generator(spec, folder, **opened)
    further = () if is_file(spec) else (*repeat_folders(run_folder(spec, folder)), *published)
    return [first, *(open_generator(spec, each, **opened) for each in further)]


def is_file(spec: str) -> bool:
    """Return whether a spec is a file, by its ending; else it is a name or `module:Class`."""
    return Path(spec).suffix.lower() in FILES


def is_predictions(spec: str) -> bool:
    """Return whether a spec is a file of images that were drawn elsewhere, by its ending."""
    return Path(spec).suffix.lower() == ".parquet"


def run_folder(spec: str, folder: Path | str | None = None, tier: str | None = None) -> Path:
    """Return the run's folder of a name or class: the one given, else that of its tier.

    That is `models/runs/NAME`, or `models/runs/patients/NAME`.
    """
    usual = RUNS / PATIENTS if on_patients(tier) else RUNS
    return usual / generator_class(spec).name if folder is None else Path(folder)


def weights_folder(spec: str, folder: Path | str | None = None) -> Path:
    """Return where the weights of a generator on patients lie, by its name or class.

    In the folder given; or else in its run, if it was trained here, or published.
    """
    own = run_folder(spec, folder, PATIENTS)
    return own if folder else own_or_published(own, WEIGHTS / PATIENTS / own.name, "config.json")


def on_patients(tier: str | None) -> bool:
    """Return whether a tier is that of still patients, on which generators adapt.

    Raises:
        RacinesError: an unknown tier, or hearts that beat.
    """
    if tier not in (None, "heart", PATIENTS):
        told = "generators know no phase of the beat" if tier == "beating" else "unknown tier"
        raise RacinesError(f"--tier {tier}: {told}: choose heart or {PATIENTS}")
    return tier == PATIENTS


def weights_of(
    spec: str, folder: Path | str | None = None, published: Sequence[Path] = ()
) -> dict[str, str]:
    """Return the SHA-256 of the file, or of the weights in the run's folder, by file name."""
    if is_file(spec):
        return {Path(spec).name: sha256_file(Path(spec))}
    first = run_folder(spec, folder)
    hashes = weights_sha256(first)
    for each in (*repeat_folders(first), *published):
        hashes |= {f"{each.name}/{file}": told for file, told in weights_sha256(each).items()}
    return hashes
