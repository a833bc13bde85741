"""How a servo's network learns: from a bank of frames that grows patient by patient."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn
from torch.nn.functional import binary_cross_entropy_with_logits
from torch.optim import AdamW, Optimizer

from racines_data.errors import RacinesError
from racines_data.patients.patient import PATIENTS_VERSION
from racines_data.patients.splits import seeds_of
from racines_data.randomness import derive, uniform
from racines_data.views import VIEWS
from racines_envs.agents.servo.frames import FrameConfig, Frames
from racines_envs.agents.servo.visits import VisitConfig
from racines_models.networks.servo import SCALE, SIDE, WIDTHS, Reading, ServoNetwork
from racines_models.training.augmentation import Augmentation, augment
from racines_models.training.objective import Course, Training, Update

NEAR = 0.09, 1.6
"""Ways longer than that, m and rad, teach nothing: the view is out of the picture."""
AT_HAND = 0.015, 0.3
"""Ways shorter than that are told apart in validation: there an agent decides whether to rest."""
GRADED = 5.0
"""Weight of the cross entropies of scores and grades beside the ways' likelihood."""
FIRST = 16
"""Patients in the bank at the start."""
LATER = 0.5
"""Share of the learning rate in the rounds after the first training, if they name none."""
STREAM = 331
JUDGED = 512
"""Frames read at once in validation."""


@dataclass(frozen=True)
class ServoConfig:
    """What a servo learns from, and how."""

    patients: int = 160
    """Train patients; each costs some 4 seconds on a CPU core once, and 5 MB of memory (18 MB at
    128 pixels)."""
    validation_patients: int = 4
    """Validation patients whose frames are read on the way."""
    frames: FrameConfig = FrameConfig()
    visits: VisitConfig = VisitConfig()
    widths: tuple[int, ...] = WIDTHS
    """Channels of the network, each at half the pixels a side of the one before: five look at
    images of 64 pixels a side, six at 128, which is all that there is."""
    blocks: tuple[int, ...] = ()
    """Residual blocks of each width after the first; one of each if empty."""
    grown: float = 0.1
    """Share of the budget after which all patients are in the bank: few at first, so that a
    training begins at once; soon all, since what is learned of a few hearts is of them alone."""
    images: int = 600_000
    """Training images seen, with repetition."""
    batch_size: int = 128
    learning_rate: float = 1.5e-3
    """Peak of AdamW's rate; it falls to zero linearly after a short rise."""
    weight_decay: float = 0.01
    gradient_clip: float = 1.0
    ema: float = 0.998
    """Decay of the averaged weights that are kept."""
    augmentation: Augmentation = Augmentation(gain=0.15, tgc=0.1, gamma=0.12)
    """Of the scanner's settings; a patient's own vary beside."""
    precision: str = "auto"
    """As the trainer's: `fp32`, mixed `bf16` or `fp16`, or `auto`."""
    store: str = ""
    """Folder that keeps the frames; `frames` in the run's own if empty."""
    processes: int = 1
    """Processes that draw frames; several draw all of them before the training begins."""
    threads: int = 1
    """CPU threads; 0 leaves torch as it is."""
    device: str = "cpu"

    def __post_init__(self) -> None:
        known = len(seeds_of("train")), len(seeds_of("validation"))
        if not 0 < self.patients <= known[0] or not 0 < self.validation_patients <= known[1]:
            raise RacinesError(
                f"agents.servo: {self.patients} patients and {self.validation_patients} for "
                f"validation: there are 1 to {known[0]} and {known[1]}"
            )
        if self.visits.beside > self.patients:
            raise RacinesError(
                f"agents.servo.visits.beside: {self.visits.beside} of {self.patients} patients"
            )
        if len(self.widths) not in (5, 6) or min(self.widths) < 1:
            raise RacinesError(f"agents.servo.widths: {self.widths}: give five or six channels")
        if self.blocks and (len(self.blocks) != len(self.widths) - 1 or min(self.blocks) < 1):
            raise RacinesError(
                f"agents.servo.blocks: {self.blocks}: give one or more for each of the "
                f"{len(self.widths) - 1} widths after the first, or nothing"
            )
        if not 0.0 < self.grown <= 1.0 or self.processes < 1:
            raise RacinesError(
                "agents.servo: grown is a share above 0, and processes are 1 or more"
            )

    @property
    def side(self) -> int:
        """Pixels of the images along a side."""
        return 2 ** (len(self.widths) + 1)


class Batch(NamedTuple):
    """B frames of the bank."""

    images: Tensor
    ways: Tensor
    scores: Tensor
    grades: Tensor
    seeds: Tensor


class Bank:
    """Frames of patients, drawn when they are first needed."""

    def __init__(
        self, seeds: Sequence[int], frames: int, make: Callable[[int], Frames], side: int = SIDE,
        device: torch.device | str = "cpu",
    ) -> None:  # fmt: skip
        """Take whose frames it will hold, how many of each at most, and what draws them.

        Args:
            seeds: of the patients.
            frames: of one patient at most.
            make: draws a patient's.
            side: pixels of an image along a side.
            device: where they lie.
        """
        self._seeds, self._make = seeds, make
        room, views = len(seeds) * frames, len(VIEWS)
        images = torch.empty(room, side, side, dtype=torch.uint8, device=device)
        ways, *shown = (torch.empty(room, views, *size, device=device) for size in ((6,), (), ()))
        self._columns = Frames(images, ways, *shown)
        self._ends = [0]

    def holding(self, patients: int) -> Frames:
        """Return the frames of so many patients."""
        while len(self._ends) <= patients:
            found = self._make(self._seeds[len(self._ends) - 1])
            begin, end = self._ends[-1], self._ends[-1] + len(found.images)
            for column, new in zip(self._columns, found, strict=True):
                column[begin:end] = new
            self._ends.append(end)
        return Frames(*(column[: self._ends[patients]] for column in self._columns))

    def __len__(self) -> int:
        return len(self._seeds)


class ServoLearner(Course):
    """What the trainer needs of a servo's network."""

    name = "servo"

    def __init__(
        self, config: ServoConfig, bank: Bank, held: Bank, seed: int,
        start: ServoNetwork | None = None, visited: Bank | None = None, turn: int = 0,
    ) -> None:  # fmt: skip
        """Build the network, or learn on with one.

        Args:
            config: all settings.
            bank: frames of train patients.
            held: frames of validation patients.
            seed: of weights and batches.
            start: what a round before has learned.
            visited: what it has seen on its own ways.
            turn: the round, 0 for the first training.
        """
        self.config, self.seed, self.device = config, seed, torch.device(config.device)
        self._bank, self._held, self._visited, self._turn = bank, held, visited, turn
        self._batch, self._peak = config.batch_size, config.learning_rate
        if turn:
            self._batch = config.visits.batch_size or self._batch
            self._peak = config.visits.learning_rate or LATER * self._peak
        plain = ServoNetwork(len(VIEWS), config.widths, config.blocks) if start is None else start
        self.network = plain.to(self.device)
        self.scale = torch.tensor(SCALE, device=self.device)
        aside = {"threads", "processes", "device", "store"} | (set() if turn else {"visits"})
        told = {key: value for key, value in asdict(config).items() if key not in aside}
        self.identity = {"agent": self.name, "seed": seed, "world": PATIENTS_VERSION, **told}
        self.identity |= {"round": turn}
        self.history: list[dict[str, float]] = []

    @property
    def training(self) -> Training:
        """The trainer's settings."""
        config = self.config
        images = config.visits.images if self._turn else config.images
        # As often in a long training as in one of a million images, however fast it is.
        times = max(1, images // 1_000_000)
        every: Any = {"log_every": 5_000, "sample_every": 40_000, "checkpoint_every": 20_000}
        every = {name: times * each for name, each in every.items()}
        learned = Training(images, self._batch, config.precision, config.ema, config.gradient_clip)
        return Training(**{**asdict(learned), **every})

    def modules(self) -> dict[str, nn.Module]:
        """Return the network."""
        return {"network": self.network}

    def averaged(self) -> tuple[str, ...]:
        """Name it: its weights are averaged."""
        return ("network",)

    def optimizers(self) -> dict[str, Optimizer]:
        """Return its AdamW; `rate` is the whole rate."""
        decay = self.config.weight_decay
        return {"network": AdamW(self.network.parameters(), lr=1.0, weight_decay=decay)}

    def rate(self, step: int) -> float:
        """Return the learning rate."""
        done = step * self._batch / self.training.stop
        return self._peak * min(1.0, (step + 1) / 200) * max(0.0, 1.0 - done)

    def batches(self, start: int, stop: int) -> Iterator[Batch]:
        """Yield batches, each a function of the seed and of how many images went before."""
        size, config, every = self._batch, self.config, len(self._bank)
        first = (config.visits.beside or every) if self._turn else min(FIRST, every)
        every = first if self._turn else every
        for seen in range(start, stop, size):
            grown = min(1.0, seen / (config.grown * stop))
            frames = self._bank.holding(first + round((every - first) * grown))
            stream = torch.full((size,), STREAM + self._turn)
            seeds = derive(stream, self.seed, torch.arange(size) + seen)
            chance = uniform(seeds, 1, 1)[:, 0].double().to(frames.images.device)
            rows = (chance * len(frames.images)).long()
            columns = [column[rows] for column in frames]
            if self._visited is not None:
                own = self._visited.holding(len(self._visited))
                count = round(size * config.visits.share)
                rows = (chance[:count] * len(own.images)).long()
                parts = zip(columns, own, strict=True)
                columns = [torch.cat([its[rows], most[count:]]) for most, its in parts]
            yield Batch(*(column.to(self.device) for column in (*columns, seeds)))

    def updates(self, nets: Mapping[str, nn.Module], batch: Batch) -> Iterator[Update]:
        """Yield the one step: ways are Laplace distributed, the rest as a coin's chances."""
        light = batch.images.unsqueeze(1).float() / 127.5 - 1.0
        varied = augment(light, batch.seeds, self.config.augmentation)
        ways, sureness, scores, grades = nets["network"]((varied + 1.0) / 2.0)
        missed = (ways.float() - batch.ways / self.scale).abs()
        weight = _near(batch.ways, NEAR)
        loss = (missed / sureness.float().exp() + sureness.float()) * weight
        led = loss.sum() / (weight.sum() * 6.0).clamp_min(1.0)
        said, truth = torch.stack([scores, grades]), torch.stack([batch.scores, batch.grades])
        graded = binary_cross_entropy_with_logits(said.float(), truth)
        yield Update("network", led + GRADED * graded, {})

    @torch.no_grad()
    def look(self, seen: int, folder: Path) -> dict[str, float]:
        """Read validation patients' frames; return mean errors, those of ways along an axis."""
        frames = Frames(*(each.cpu() for each in self._held.holding(len(self._held))))
        parts = [self.network.read(part.to(self.device)) for part in frames.images.split(JUDGED)]
        read = Reading(*(torch.cat(each).cpu() for each in zip(*parts, strict=True)))
        missed, row = (read.ways - frames.ways).abs(), {}
        for name, most in (("", NEAR), ("at_hand_", AT_HAND)):
            near = _near(frames.ways, most)
            mean = (missed * near).sum((0, 1)) / near.sum()
            row[f"validation/{name}position_error"] = float(mean[:3].mean()) * 1e3
            row[f"validation/{name}rotation_error"] = float(torch.rad2deg(mean[3:]).mean())
            pairs = {
                "score": (read.scores, frames.scores),
                "grade": (read.grades / 10, frames.grades),
            }
            for what, (said, true) in pairs.items():
                wrong = (said - true).abs() * near.squeeze(-1)
                row[f"validation/{name}{what}_error"] = float(wrong.sum() / near.sum())
        self.history.append({"images": seen, **row})
        return row

    def state(self) -> dict[str, Any]:
        """Return the figures so far."""
        return {"history": self.history}

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a saved state."""
        self.history = state["history"]


def _near(ways: Tensor, most: tuple[float, float]) -> Tensor:
    """Return (B, V, 1) float32: 1 where a way is shorter than so many m and rad."""
    shift, turn = ways[..., :3].norm(dim=-1), ways[..., 3:].norm(dim=-1)
    return ((shift < most[0]) & (turn < most[1])).float().unsqueeze(-1)
