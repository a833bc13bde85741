"""Who draws the images that a servo learns from: generators, and the truth made worse in steps.

What names one:

    truth:blur=4              what the patient's heart shows, blurred
    truth:stray=8             as it would be seen 8 mm and 8 degrees off
    truth:wrong=0.5           in half of the frames somebody else's heart, lying in the same place
    scout-attention           a generator that adapts, as it was trained here or published
    vae-gan:FOLDER            a generator of a run, whether it adapts or not
    scout-mean                the mean frame of the scout
    LABEL=any of these        under a name of one's own
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

from racines_data.errors import RacinesError
from racines_data.files import sha256_file
from racines_data.geometry import (
    Pose,
    axis_angle_to_matrix,
    matmul3,
    orthonormalise,
    parameters_to_pose,
)
from racines_data.patients.patient import Patient
from racines_data.patients.pool import Pool
from racines_data.randomness import derive, normal, uniform
from racines_models.adapting import adapted
from racines_models.contract import declared
from racines_models.protocol import Adapting
from racines_models.provenance import weights_sha256
from racines_models.registry import generator_class, is_file, open_generator, weights_folder
from racines_models.sample import drawn_of
from racines_models.scores.on_patients import open_for_patients

TRUTH, MEAN = "truth", "scout-mean"
STREAM = 977
CONFIG = "config.json"
"""Settings of a trained run, in its folder."""
AT_ONCE = 64
"""Images that are drawn, or blurred, at a time."""


class Examined(NamedTuple):
    """A patient whom somebody examined in K places, as they lie in each."""

    patients: tuple[Patient, ...]
    others: tuple[Patient, ...]
    """Somebody else, as they would lie in each place."""
    scouts: Tensor
    """(K, 64, 128, 128) uint8."""
    parameters: Tensor
    """(K, 64, 12) float32 of the scouts."""


@dataclass(frozen=True)
class Point(ABC):
    """Draws what a probe would see of a patient."""

    label: str
    spec: str
    """What names it, without the label."""

    @abstractmethod
    def kind(self) -> str:
        """Return `truth`, `adapts`, `ignores the patient` or `floor`."""

    @property
    def weights(self) -> dict[str, str]:
        """SHA-256 of the files that it draws with, by name."""
        return {}

    @abstractmethod
    def draw(self, examined: Examined, rows: Tensor, parameters: Tensor, seeds: Tensor) -> Tensor:
        """Return (N, 128, 128) uint8 images.

        Args:
            examined: the patient.
            rows: (N,) int64, in which place.
            parameters: (N, 12) float32 of the probe.
            seeds: (N,) int64, of all chance.
        """


@dataclass(frozen=True)
class Truth(Point):
    """What the patient's heart shows, or less."""

    blur: float = 0.0
    """Standard deviation of a Gaussian, pixels of 128."""
    stray: float = 0.0
    """Standard deviations of the probe's true pose about the one that is told, mm along the skin
    and degrees about each axis."""
    wrong: float = 0.0
    """Share of the frames that show somebody else's heart."""

    def __post_init__(self) -> None:
        amounts = self.blur, self.stray, self.wrong
        if not all(map(math.isfinite, amounts)) or min(amounts) < 0.0 or self.wrong > 1.0:
            raise RacinesError(f"{self.spec}: blur and stray are 0 or more, wrong is a share")

    def kind(self) -> str:
        """Return that it is the truth."""
        return TRUTH

    def draw(self, examined: Examined, rows: Tensor, parameters: Tensor, seeds: Tensor) -> Tensor:
        """Return what is seen (see `Point`)."""
        count = len(examined.patients)
        own = derive(seeds, STREAM)
        pose = parameters_to_pose(parameters.double())
        if self.stray:
            pose = strayed(pose, own, self.stray)
        pool = Pool([*examined.patients, *(examined.others if self.wrong else ())])
        other = uniform(own, 1, STREAM)[:, 0] < self.wrong
        images = pool.render(pose, torch.where(other, rows + count, rows), seeds=own)
        return blurred(images, self.blur) if self.blur else images


@dataclass(frozen=True)
class Drawn(Point):
    """What a generator draws, adapted to each scout if it can."""

    generator: Any
    folder: Path
    """Of its run."""

    @property
    def weights(self) -> dict[str, str]:
        """SHA-256 of the run's weights and settings; none of what is not trained."""
        settings = self.folder / CONFIG
        if not settings.is_file():
            return {}
        return weights_sha256(self.folder) | {CONFIG: sha256_file(settings)}

    def kind(self) -> str:
        """Return whether it adapts; what is not trained is a floor."""
        if declared(self.generator).trained is False:
            return "floor"
        return "adapts" if isinstance(self.generator, Adapting) else "ignores the patient"

    def draw(self, examined: Examined, rows: Tensor, parameters: Tensor, seeds: Tensor) -> Tensor:
        """Return its images (see `Point`)."""
        places, images = [], []
        pairs = zip(examined.scouts, examined.parameters, strict=True)
        for place, (scout, swept) in enumerate(pairs):
            seed = int(derive(torch.tensor(STREAM), examined.patients[0].seed, place))
            source = adapted(self.generator, scout, swept, seed)
            for part in (rows == place).nonzero().squeeze(1).split(AT_ONCE):
                places.append(part)
                images.append(drawn_of(source, parameters[part], seeds[part]))
        return torch.cat(images)[torch.cat(places).argsort()]


@dataclass(frozen=True)
class Mean(Point):
    """The mean frame of the scout in each place, wherever the probe is."""

    def kind(self) -> str:
        """Return that it is a floor."""
        return "floor"

    def draw(self, examined: Examined, rows: Tensor, parameters: Tensor, seeds: Tensor) -> Tensor:
        """Return that image of each row's place (see `Point`)."""
        total = examined.scouts.sum(1, dtype=torch.int64).double()
        return (total / examined.scouts.shape[1]).round().to(torch.uint8)[rows]


def strayed(pose: Pose, seeds: Tensor, amount: float) -> Pose:
    """Return (N,) poses about others: `amount` mm along the skin, and degrees about each axis."""
    chance = normal(seeds, 5, STREAM + 1).double() * amount
    shift = torch.cat([chance[:, :2] * 1e-3, torch.zeros_like(chance[:, :1])], 1)
    turn = axis_angle_to_matrix(torch.deg2rad(chance[:, 2:]))
    return Pose(pose.position + shift, orthonormalise(matmul3(pose.rotation, turn)))


def blurred(images: Tensor, deviation: float) -> Tensor:
    """Return (N, H, W) uint8 images after a Gaussian of so many pixels, edges repeated."""
    reach = int(4.0 * deviation + 0.5)
    away = torch.arange(-reach, reach + 1, dtype=torch.float64)
    taps = torch.exp(-0.5 * (away / deviation).square())
    taps = (taps / taps.sum()).float().view(1, 1, -1, 1)
    parts = []
    for part in images.unsqueeze(1).split(AT_ONCE):
        wide = functional.pad(part.float(), [reach] * 4, mode="replicate")
        tall = functional.conv2d(functional.conv2d(wide, taps), taps.transpose(2, 3))
        parts.append(tall.squeeze(1).round().to(torch.uint8))
    return torch.cat(parts)


def open_point(spec: str, device: str = "cpu") -> Point:
    """Return what a spec names.

    Raises:
        RacinesError: an unknown way to make the truth worse, or a generator that is not there.
    """
    named, equals, rest = spec.partition("=")
    label = named if equals and ":" not in named else ""
    body = rest if label else spec
    what, _, more = body.partition(":")
    if what == TRUTH:
        return Truth(label or body, body, **_worse(body, more))
    if body == MEAN:
        return Mean(label or body, body)
    if is_file(body):
        raise RacinesError(f"{spec}: a file cannot adapt to a patient: give NAME or NAME:FOLDER")
    if "." in what and more:  # module:Class
        attribute, _, more = more.partition(":")
        what = f"{what}:{attribute}"
    folder = Path(more) if more else weights_folder(what)
    if more and not (folder / CONFIG).is_file():
        raise RacinesError(f"{spec}: no trained generator in {folder}: give the folder of a run")
    opened: Any = (
        open_generator(what, folder, device) if more
        else open_for_patients(what, folder, device=device)[0]
    )  # fmt: skip
    if not hasattr(opened, "generate"):
        raise RacinesError(f"{spec}: it draws no other pose: name a generator, or {TRUTH}")
    return Drawn(label or _short(what, folder, bool(more)), body, opened, folder)


def open_points(specs: Sequence[str], device: str = "cpu") -> list[Point]:
    """Return several, one at least, each under a label of its own.

    Raises:
        RacinesError: none, two of one label, or as `open_point`.
    """
    if not specs:
        raise RacinesError("downstream.points: name one at least")
    points = [open_point(spec, device) for spec in specs]
    labels = [point.label for point in points]
    for label in labels:
        if labels.count(label) > 1:
            raise RacinesError(f"two points are called {label!r}: name them, LABEL=POINT")
    return points


def _short(what: str, folder: Path, run: bool) -> str:
    name = generator_class(what).name
    return f"{name}, {folder.name}" if run and folder.name != name else name


def _worse(spec: str, more: str) -> dict[str, float]:
    """Return by how much the truth is made worse, as `blur=4,stray=2` says."""
    known = [each.name for each in fields(Truth) if isinstance(each.default, float)]
    found = {}
    for pair in filter(None, more.split(",")):
        name, _, amount = pair.partition("=")
        if name not in known:
            raise RacinesError(f"{spec}: no {name!r}: choose of {', '.join(known)}")
        if name in found:
            raise RacinesError(f"{spec}: {name} is given twice")
        try:
            found[name] = float(amount)
        except ValueError as error:
            raise RacinesError(f"{spec}: {pair!r}: write NAME=NUMBER") from error
    return found
