"""How a memory learns to look back."""

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple, cast

import torch
from torch import Tensor, nn
from torch.nn.functional import binary_cross_entropy_with_logits
from torch.optim import AdamW, Optimizer

from racines_data.errors import RacinesError
from racines_data.patients.patient import PATIENTS_VERSION
from racines_data.patients.splits import seeds_of
from racines_data.randomness import derive, uniform
from racines_data.views import VIEWS
from racines_envs.agents.memory.episodes import EpisodeConfig, Episodes
from racines_envs.agents.memory.lead import BESIDE
from racines_models.networks.recall import LIES, RecallNetwork
from racines_models.training.objective import Course, Training, Update

STREAM = 367
ASKED = 48
"""Poses passed that are asked about in each episode and step."""
THINNED = 0.6
"""Greatest share of an episode's images that a step leaves out, so that no image is relied on."""
EVERY = 2
"""Of an episode's images one of so many is taken, from a first by chance."""
BLIND = 0.02
"""Least weight of a pose passed in which are asked about: half by how completely they show."""
ENDS = 0.4
"""Share asked about by what is known in the end, when an agent chooses."""
LATER = 0.5
"""Share of the learning rate in the rounds after the first training."""


@dataclass(frozen=True)
class MemoryConfig:
    """What a memory learns from, and how."""

    members: str = "servo"
    """Run of a servo, a name, trained here or published, or a folder. A training sees through the
    servo's of the same seed."""
    patients: int = 60
    """Train patients on whom the servo acts, after the `first`."""
    first: int = 1_000
    """Train patients left out before: those that the servo knows from its training."""
    rounds: int = 1
    """Times that the agent itself acts, on other patients, and learns on; 0: never."""
    round_patients: int = 30
    """Train patients on whom it acts in a round."""
    validation_patients: int = 4
    """Validation patients whose episodes, of the servo, are looked at on the way."""
    acts: EpisodeConfig = EpisodeConfig()
    bounded: bool = False
    """Whether a reading is believed only as far as the edge of where train patients' views lie."""
    looks: int = 0
    """Poses, 0 to 4, from which it looks about the best of all passed, before it chooses again."""
    episodes: int = 16_000
    """Episodes learned from, with repetition."""
    round_episodes: int = 8_000
    """In a round, of all episodes so far."""
    batch_size: int = 16
    learning_rate: float = 1e-3
    """Peak of AdamW's rate; it falls to zero linearly after a short rise."""
    weight_decay: float = 0.05
    gradient_clip: float = 1.0
    ema: float = 0.998
    """Decay of the averaged weights that are kept."""
    precision: str = "auto"
    """As the trainer's: `fp32`, mixed `bf16` or `fp16`, or `auto`."""
    store: str = ""
    """Folder that keeps the episodes; `episodes` in the run's own if empty."""
    processes: int = 1
    """Processes that act on patients."""
    threads: int = 1
    """CPU threads; 0 leaves torch as it is."""
    device: str = "cpu"

    def __post_init__(self) -> None:
        if not 0 <= self.looks <= len(BESIDE):
            raise RacinesError(f"agents.servo-memory: looks {self.looks}: 0 to {len(BESIDE)}")
        needed = self.first + self.patients + self.rounds * self.round_patients
        known = len(seeds_of("train")), len(seeds_of("validation"))
        if min(self.patients, self.round_patients, self.validation_patients, self.processes) < 1:
            raise RacinesError("agents.servo-memory: patients and processes are 1 or more")
        if needed > known[0] or self.validation_patients > known[1]:
            raise RacinesError(
                f"agents.servo-memory: {needed} train patients with the first ones left out, and "
                f"{self.validation_patients} for validation: there are {known[0]} and {known[1]}"
            )

    @property
    def trained_on(self) -> list[int]:
        """Return the seeds of the patients of the first training."""
        return list(seeds_of("train")[self.first : self.first + self.patients])

    def met_in(self, turn: int) -> list[int]:
        """Return those of a round, 1 or more."""
        begin = self.first + self.patients + (turn - 1) * self.round_patients
        return list(seeds_of("train")[begin : begin + self.round_patients])


class Batch(NamedTuple):
    """B episodes, and what is asked of each."""

    episodes: Episodes
    seeds: Tensor


class MemoryLearner(Course):
    """What the trainer needs of a memory."""

    name = "servo-memory"

    def __init__(
        self, config: MemoryConfig, own: Episodes, held: Episodes, seed: int, eyes: str,
        start: RecallNetwork | None = None, turn: int = 0,
    ) -> None:  # fmt: skip
        """Build the network, or learn on with one.

        Args:
            config: all settings.
            own: episodes on train patients.
            held: on validation patients.
            seed: of weights and batches.
            eyes: SHA-256 of the servo's weights.
            start: what a round before has learned.
            turn: the round, 0 for the first training.
        """
        self.config, self.seed, self.device = config, seed, torch.device(config.device)
        self._own, self._held, self._turn = own, held, turn
        self.network = start or RecallNetwork(len(VIEWS)).to(self.device)
        self.network.eyes.copy_(torch.tensor(list(bytes.fromhex(eyes)), dtype=torch.uint8))
        aside = {"threads", "processes", "device", "store"}
        aside |= set() if turn else {"rounds", "round_patients", "round_episodes"}
        told = {key: value for key, value in asdict(config).items() if key not in aside}
        self.identity = {"agent": self.name, "seed": seed, "world": PATIENTS_VERSION, **told}
        self.identity |= {"round": turn, "eyes": eyes}
        self.history: list[dict[str, float]] = []

    @property
    def training(self) -> Training:
        """The trainer's settings."""
        config = self.config
        seen = config.round_episodes if self._turn else config.episodes
        return Training(
            images=seen, batch_size=config.batch_size, precision=config.precision, ema=config.ema,
            gradient_clip=config.gradient_clip, log_every=800, sample_every=4_000,
            checkpoint_every=4_000,
        )  # fmt: skip

    @property
    def frames(self) -> int:
        """Return the steps of all train patients' episodes."""
        return int(self._own.seen.sum())

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
        done = step * self.config.batch_size / self.training.stop
        peak = self.config.learning_rate * (LATER if self._turn else 1.0)
        return peak * min(1.0, (step + 1) / 100) * max(0.0, 1.0 - done)

    def batches(self, start: int, stop: int) -> Iterator[Batch]:
        """Yield batches, each a function of the seed and of how many episodes went before."""
        size = self.config.batch_size
        for seen in range(start, stop, size):
            stream = torch.full((size,), STREAM + self._turn)
            seeds = derive(stream, self.seed, torch.arange(size) + seen)
            chance = uniform(seeds, 2, 1).double()
            rows = (chance[:, 0] * len(self._own.labels)).long()
            begin = int(chance[0, 1] * EVERY)
            taken = self._own._replace(
                tokens=self._own.tokens[rows, begin::EVERY].float(),
                seen=self._own.seen[rows, begin::EVERY],
                truths=self._own.truths[rows, begin::EVERY].float(),
                labels=self._own.labels[rows],
                target=self._own.target[rows],
            )
            yield Batch(Episodes(*(each.to(self.device) for each in taken)), seeds.to(self.device))

    def updates(self, nets: Mapping[str, nn.Module], batch: Batch) -> Iterator[Update]:
        """Yield the one step: places are Laplace distributed, the rest as a coin's chances."""
        (tokens, there, truths, labels, target), seeds = batch
        length = tokens.shape[1]
        left_out = uniform(seeds, 1, 2) * THINNED
        seen = there & (uniform(seeds, length, 3) >= left_out)
        seen[:, 0] = True
        network = nets["network"]
        recalled = network(tokens, seen, labels)
        missed = (recalled.centre.float() - target.unsqueeze(1)).abs()
        sureness, weight = recalled.sureness.float(), seen.unsqueeze(-1).float()
        loss = (missed / sureness.exp() + sureness) * weight
        led = loss.sum() / (weight.sum() * len(LIES))
        which, by = _asked(seeds, there, truths[..., 0])
        scorer = cast(RecallNetwork, getattr(network, "module", network))
        said = scorer.score(tokens, seen, labels, recalled, which, by).float()
        row = torch.arange(len(labels), device=labels.device).unsqueeze(1)
        hits = batch.episodes.hits.float().unsqueeze(-1)
        truth = torch.cat([truths, hits], -1)[row, which].clamp(0.0, 1.0)
        judged = binary_cross_entropy_with_logits(said, truth) * truth.shape[-1]
        yield Update("network", led + judged, {})

    @torch.no_grad()
    def look(self, seen: int, folder: Path) -> dict[str, float]:
        """Look back over validation patients' episodes; return errors, and how well it chooses."""
        parts = []
        for rows in torch.arange(len(self._held.labels)).split(16):
            part = Episodes(*(column[rows].to(self.device) for column in self._held))
            centre, hits = self.network.recall(part.tokens.float(), part.seen, part.labels)
            missed = (centre - part.target).abs() * torch.tensor(LIES, device=self.device)
            best = part.hits.gather(1, hits.argmax(1, keepdim=True)).squeeze(1)
            parts.append((missed, best, part.hits.any(1)))
        missed, best, passed = (torch.cat(column) for column in zip(*parts, strict=True))
        row = {
            "validation/position_error": float(missed[:, :3].mean()) * 1e3,
            "validation/rotation_error": float(torch.rad2deg(missed[:, 3:].mean())),
            "validation/chosen": float(best.float().mean()),
            "validation/passed": float(passed.float().mean()),
        }
        self.history.append({"episodes": seen, **row})
        return row

    def state(self) -> dict[str, Any]:
        """Return the figures so far."""
        return {"history": self.history}

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a saved state."""
        self.history = state["history"]


def _asked(seeds: Tensor, there: Tensor, shown: Tensor) -> tuple[Tensor, Tensor]:
    """Return (B, ASKED) poses passed, by chance, and the last image that each is judged by.

    Half of them by how completely they show the view, and judged by no earlier image than theirs.
    """
    count = there.sum(1, keepdim=True)
    chance = uniform(seeds, 3 * ASKED, 4).view(-1, 3, ASKED).to(there.device)
    which = (chance[:, 0] * count).long().clamp_max(there.shape[1] - 1)
    by = (chance[:, 1] * count).long().clamp_max(there.shape[1] - 1)
    rising = ((shown + BLIND) * there).cumsum(1)
    half = ASKED // 2
    showing = torch.searchsorted(rising, chance[:, 0, :half].contiguous() * rising[:, -1:])
    showing = torch.minimum(showing, count - 1)
    which = torch.cat([showing, which[:, half:]], 1)
    by[:, :half] = torch.maximum(by[:, :half], showing)
    return which, torch.where(chance[:, 2] < ENDS, count - 1, by)
