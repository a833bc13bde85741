"""Scouts of patients as a store: what a generator learns from that is to adapt to a patient.

    a patient in one of several places ──> 64 frames of a scout, then 32 frames at poses asked for

Such a run of 96 frames is a trajectory of the store. A heart is scanned as it lies and is examined
in several patients of its split: that costs a search for its views, a new heart seconds of baking.
The frames of one heart are a shard on disk, a function of the patient, the settings and
the world's version alone, so that drawing goes on where it was killed.
"""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch
from safetensors.torch import save_file
from torch import Tensor

from racines_data.digest import recipe_digest
from racines_data.errors import RacinesError
from racines_data.files import read_tensors, write_once
from racines_data.patients.patient import PATIENTS_VERSION, Patient
from racines_data.patients.pool import Pool
from racines_data.patients.population import draw_patient, lie_anew
from racines_data.patients.scouts import FRAMES, POSES, SCOUTS_VERSION, STRATA, Scouted, scout
from racines_data.patients.splits import SPLITS, check_split, seeds_of, split_of
from racines_data.randomness import derive, uniform
from racines_data.records import PIXELS
from racines_data.schema import CONTROLS
from racines_data.store.frames import BatchMemory, FrameStore
from racines_data.views import RANDOM

RUN = FRAMES + POSES
"""Frames of a trajectory: the scout, then what was asked for."""
FOLDER = Path("models/runs/scouts")
"""Where scouts that generators learn from are kept."""
COLUMNS = "images", "parameters", "truth", "asked"
"""Of what is scouted, what a shard holds."""
_STREAM = 0x9C47


@dataclass(frozen=True)
class ScoutsConfig:
    """Whose scouts a generator learns from."""

    train: int | tuple[int, ...] = 100
    """Patients of the split: how many, from its first seed on, or their seeds."""
    validation: int | tuple[int, ...] = 8
    """Those whom a training looks at, and never learns from."""
    places: int = 3
    """Places in which a train patient lies and is examined: their own, and those of others."""
    seed: int = 0
    """Names the scouts."""

    def __post_init__(self) -> None:
        if self.places < 1:
            raise RacinesError(f"scouts.places: {self.places}: give 1 or more")

    @property
    def count(self) -> int:
        """How many patients that is."""
        return sum(len(self.seeds(split)) for split in SPLITS)

    def seeds(self, split: str) -> tuple[int, ...]:
        """Return the patients of a split, in order; none of test.

        Raises:
            RacinesError: more than the split has, or one of another split.
        """
        wanted, known = getattr(self, split, 0), seeds_of(split)
        if isinstance(wanted, int):
            if not 0 <= wanted <= len(known):
                raise RacinesError(
                    f"scouts.{split}: {wanted}: the split has {len(known)} patients: give 0 to that"
                )
            return tuple(known[:wanted])
        check_split(list(wanted), split)
        return wanted


class MadeStore(FrameStore):
    """Frames that were drawn for this process, in memory; each trajectory is a patient in a place.

    What needs a patient's measures, masks, or labels of views has none here.
    """

    def _hold(self, images: Tensor, parameters: Tensor, patients: list[int], length: int) -> None:
        """Take (N, 128, 128) images and (N, 12) parameters, `length` frames a trajectory."""
        self.images, self.parameters = images, parameters
        self._memory = BatchMemory()
        self._words = images.view(-1, PIXELS).view(torch.int64)
        self.views = torch.full((len(images),), -1)
        self.grades = torch.full((len(images),), torch.nan)
        self.controls = torch.full((len(images), len(CONTROLS)), torch.nan)
        self.timestamps = torch.zeros(len(images), dtype=torch.float64)
        self.trajectory_index = torch.arange(len(patients)).repeat_interleave(length)
        self.frame = torch.arange(length).repeat(len(patients))
        self.patients, self.phantoms = patients, [None] * len(patients)
        self.trajectories = [f"scout-{place}" for place in range(len(patients))]
        self.sessions = [f"patient-{seed:05d}" for seed in patients]
        self.target_views = [RANDOM] * len(patients)

    @property
    def digest(self) -> str:
        """The digest of the recipe: the frames are never written as a dataset."""
        return self.manifest["digest"]

    def __reduce__(self) -> Any:
        raise TypeError("scouts stay in the process that read them")


class ScoutStore(MadeStore):
    """All scouts that settings name, each followed by the frames that are asked for."""

    def __init__(
        self, folder: Path, config: ScoutsConfig, progress: Callable[[int], None] | None = None
    ) -> None:
        """Read the shards in a folder; draw those that are not there.

        Raises:
            RacinesError: more patients than a split has, or a damaged shard.
        """
        self.config, self.root = "scouts", Path(folder)
        wanted = {name: config.seeds(name) for name in SPLITS}
        if not wanted["train"]:
            raise RacinesError("scouts.train: no patient to learn from: give 1 or more")
        parts: list[dict[str, Tensor]] = []
        patients: list[int] = []
        self._splits = {}
        for name, seeds in wanted.items():
            first = len(patients)
            for seed in seeds:
                places = config.places if name == "train" else 1
                parts.append(shard(seed, places, config.seed, self.root))
                patients += [seed] * places
                if progress is not None:
                    progress(1)
            self._splits[name] = [first * RUN, len(patients) * RUN]
        self._fill(parts, patients, config)

    def _fill(
        self, parts: list[dict[str, Tensor]], patients: list[int], config: ScoutsConfig
    ) -> None:
        """Lay the frames of all trajectories end to end."""
        images = torch.empty(len(patients), RUN, 128, 128, dtype=torch.uint8)
        parameters = torch.empty(len(patients), RUN, 12)
        start = 0
        for part in parts:
            rows = slice(start, start + len(part["images"]))
            images[rows, :FRAMES], images[rows, FRAMES:] = part["images"], part["truth"]
            parameters[rows, :FRAMES] = part["parameters"]
            parameters[rows, FRAMES:] = part["asked"]
            start = rows.stop
            part.clear()
        self._hold(images.flatten(0, 1), parameters.flatten(0, 1), patients, RUN)
        recipe = recipe_digest(recipe_of(config))
        told: dict[str, Any] = {"source": "scouts", "version": PATIENTS_VERSION}
        self.manifest = told | {"digest": recipe, "recipe_digest": recipe}


def recipe_of(config: ScoutsConfig) -> dict[str, Any]:
    """Return all that decides what scouts show."""
    told = {"world": PATIENTS_VERSION, "scouts": SCOUTS_VERSION, "strata": list(STRATA)}
    return told | {"frames": FRAMES, "poses": POSES, **asdict(config)}


def shard(patient: int, places: int, seed: int, folder: Path) -> dict[str, Tensor]:
    """Return a patient's scouts in (P,) places from a folder, or draw them and put them there."""
    told = {"world": PATIENTS_VERSION, "scouts": SCOUTS_VERSION, "patient": patient}
    told |= {"places": places, "seed": seed}
    path = folder / f"{patient}-{recipe_digest(told)[:16]}.safetensors"
    if not path.is_file():
        made = [scout(Pool([each]), seed + place, masks=False)
                for place, each in enumerate(lying(patient, places))]  # fmt: skip
        joined = Scouted(*(torch.cat(column) for column in zip(*made, strict=True)))
        columns = {name: getattr(joined, name).contiguous() for name in COLUMNS}
        write_once(path, lambda part: save_file(columns, part))
    return read_tensors(path, COLUMNS)


def lying(patient: int, places: int) -> list[Patient]:
    """Return a patient, then the same lying and examined as others of the split, by chance."""
    own, split = draw_patient(patient), seeds_of(split_of(patient))
    chance = uniform(derive(torch.tensor([_STREAM]), patient), places, 1)[0].double()
    others = (chance * len(split)).long().tolist()
    return [own, *(lie_anew(own, draw_patient(split[other])) for other in others[1:])]
