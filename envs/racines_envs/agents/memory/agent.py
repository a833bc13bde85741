"""The servo with a memory."""

from dataclasses import asdict
from pathlib import Path
from typing import Any, ClassVar, Self

import torch
from torch import Tensor

from racines_data.files import write_json
from racines_data.geometry import Pose, axis_angle_to_matrix, matmul3, orthonormalise, rotate
from racines_data.views import VIEWS
from racines_envs.agents.memory.eyes import eyes_like, eyes_of
from racines_envs.agents.memory.lead import BELIEVED, Lead, Legs, best_of, either
from racines_envs.agents.memory.learner import MemoryConfig
from racines_envs.agents.memory.notes import Notes, lies, pose_at
from racines_envs.agents.memory.rounds import discard, learn
from racines_envs.agents.protocol import SETTINGS
from racines_envs.agents.servo.agent import POLICY, ServoAgent
from racines_envs.agents.servo.belief import Belief, reading
from racines_envs.agents.servo.mind import Mind
from racines_envs.agents.training import seeded
from racines_envs.task.core import ScanCore
from racines_models.devices import on_device, resolve_device
from racines_models.networks.batching import in_fixed_batches
from racines_models.networks.recall import RecallNetwork
from racines_models.networks.servo import SAID, SCALE, ServoNetwork
from racines_models.protocol import Run
from racines_models.weights import load_network, read_described, save_weights

CHOOSE, FURTHER = 125, 80
"""The servo's, but earlier: steps are left to go where all images together lead."""


class ServoMemoryAgent(ServoAgent):
    """Searches as a servo does, then looks back, and goes to the best of all poses passed."""

    name: ClassVar[str] = "servo-memory"
    Config: ClassVar[type] = MemoryConfig

    def __init__(
        self, config: Any, network: ServoNetwork, recall: RecallNetwork | None = None
    ) -> None:
        """Take a servo's network, and what looks back; without it the agent searches and notes."""
        super().__init__(config, network)
        self._eyes = network
        self.recall = None if recall is None else recall.eval()

    def attach(self, core: ScanCore) -> None:
        """Take the steps and the workspace of an environment, and learn which view is asked for."""
        super().attach(core)
        self.notes = Notes.new(core.num_envs, self._device)
        self._legs = Legs.planned(self.config.looks, core.device)
        self._lead: Lead | None = None

    def begun(self, read: Belief) -> Mind:
        """Begin episodes with a first belief."""
        mind = super().begun(read)
        if self.recall is not None:
            mind.choose, mind.further = CHOOSE, FURTHER
        return mind

    def read(self, observation: dict[str, Tensor], pose: Pose) -> tuple[Belief, Tensor]:
        """Return where the images say that the (N,) targets are, and how well they show them."""
        labels, said_by_all = self._labels(observation), len(VIEWS) * SAID

        def look(part: Tensor) -> Tensor:
            small = self._shrunk(part).unsqueeze(1).float() / 255.0
            features = self._eyes.features(small)
            ways, sureness, *shown = self._eyes.say(features)
            said = torch.cat([ways, sureness, torch.stack(shown, -1)], -1)
            return torch.cat([said.flatten(1), features], 1)

        seen = self._lasting(look, observation["image"])
        each = torch.arange(len(labels), device=labels.device)
        said = seen[:, :said_by_all].view(-1, len(VIEWS), SAID)[each, labels]
        scale = torch.tensor(SCALE, device=said.device)
        found = reading(pose, said[:, :6] * scale, said[:, 6:12].exp() * scale)
        where = [lies(at, labels) for at in (pose, found.pose)]
        self._token = torch.cat([*where, said[:, 6:], seen[:, said_by_all:]], 1)
        score, grade = said[:, 12:].sigmoid().unbind(1)
        found = found.bounded(labels) if self.config.bounded else found
        return found, score + grade - 1.0

    def goals(self, mind: Mind, pose: Pose, labels: Tensor) -> tuple[Pose, Pose]:
        """Return (N,) poses to go to from (N,) poses, and those to go to from there."""
        same = self._steering.goes_on()
        self.notes.take(self._token, mind.steps, same)
        searched = super().goals(mind, pose, labels)
        if self.recall is None:
            return searched
        lead = self._lead = self._lead or Lead.new(pose, self._legs)
        rows = lead.begin(mind, same)
        chosen = rows.nonzero().squeeze(1)
        if len(chosen):
            self._look_back(lead, chosen, labels)
        after = self._about(lead.centre, lead.waypoint(1))
        then = either(lead.looks_on, after, lead.aim)
        led = [either(lead.leads, *pair) for pair in zip((lead.aim, then), searched, strict=True)]
        return led[0], led[1]

    def slack(self) -> float | Tensor:
        """Return what a step after an idle one has to save: nothing on a leg to a place."""
        none = super().slack()
        return none if self._lead is None else torch.where(self._lead.leads, 0.0, none)

    def stepped(self, mind: Mind, reached: Tensor) -> None:
        """Take note of a step; (N,) bool rows have come to where they were going."""
        super().stepped(mind, reached)
        if self._lead is not None:
            self._lead.due = reached

    def _look_back(self, lead: Lead, rows: Tensor, labels: Tensor) -> None:
        """Lead (M,) of the rows to where all that they have seen says that the view is."""
        notes, asked, network = self.notes, labels[rows], self.recall
        assert network is not None
        tokens, kind = notes.tokens[rows], lead.kind[rows].unsqueeze(1)
        believed, hits = in_fixed_batches(
            lambda *part: network.recall(*part), tokens, notes.seen[rows], asked
        )
        best = best_of(tokens[..., :6], hits)
        centre = torch.where(kind == BELIEVED, believed, best)
        place = torch.zeros_like(labels).index_copy(0, rows, torch.ones_like(rows)).bool()

        def spread(lying: Tensor, old: Pose) -> Pose:
            new = pose_at(lying, asked)
            parts = (b.index_copy(0, rows, a) for a, b in zip(new, old, strict=True))
            return either(place, Pose(*parts), old)

        lead.centre = spread(centre, lead.centre)
        about = self._about(lead.centre, lead.waypoint(0))
        lead.aim = either(lead.looks & place, about, spread(best, lead.aim))

    def _about(self, centre: Pose, waypoint: Tensor) -> Pose:
        """Return the (N,) waypoints about (N,) poses."""
        offset, task = self._offsets[waypoint], self._task
        turn = axis_angle_to_matrix(offset[:, 3:] * task.step_rotation)
        shift = rotate(centre.rotation, offset[:, :3] * task.step_translation)
        return Pose(centre.position + shift, orthonormalise(matmul3(centre.rotation, turn)))

    @classmethod
    def train(
        cls, config: Any, run_dir: Path, *, seed: int = 0, resume: bool | None = None,
        progress: bool = True, **where: Any,
    ) -> Self:  # fmt: skip
        """Learn to look back, from episodes on train patients; arguments as of `LearningAgent`."""
        config = on_device(config)
        eyes = eyes_of(config.members, seed, config.device)
        run = Run(Path(run_dir), seed, config.device, resume, progress)
        with seeded(seed, config.threads):
            network, rounds = learn(config, run, cls, eyes)
        metrics = rounds[0] | {"rounds": rounds[1:], "views": list(VIEWS)}
        metrics |= {"frames": rounds[-1]["frames"]}
        save_weights(run.folder / POLICY, network.state_dict())
        write_json(
            run.folder / SETTINGS, {"agent": cls.name, "config": asdict(config), "seed": seed}
        )
        write_json(run.folder / "metrics.json", metrics)
        discard(run, config.rounds)
        return cls(config, eyes.network, network)

    @classmethod
    def load(cls, run_dir: Path, device: torch.device | str = "cpu") -> Self:
        """Read what `train` left, and the servo that it sees through.

        Raises:
            RacinesError: a policy of another agent, or a servo that is not there.
        """
        device, remedy = resolve_device(device), f"run `racines train agent {cls.name}`"
        content = read_described(Path(run_dir), f"no trained policy: {remedy}")
        config = cls.described(content, run_dir)
        network = RecallNetwork(len(VIEWS))
        load_network(Path(run_dir) / POLICY, network, remedy)
        eyes = eyes_like(bytes(network.eyes.tolist()).hex(), config.members, run_dir, device)
        return cls(config, eyes.network, network.to(device))
