"""The servo: it reads where the view is, believes the sum of its readings, and steps there."""

from dataclasses import asdict
from pathlib import Path
from typing import Any, ClassVar, Self

import torch
from torch import Tensor
from torch.nn import functional

from racines_data.config import fill
from racines_data.errors import RacinesError
from racines_data.files import write_json
from racines_data.geometry import Pose
from racines_data.views import VIEWS
from racines_envs.agents.protocol import SETTINGS
from racines_envs.agents.servo.belief import Belief, reading
from racines_envs.agents.servo.frames import shrink
from racines_envs.agents.servo.learner import ServoConfig
from racines_envs.agents.servo.mind import Mind, waypoints
from racines_envs.agents.servo.rounds import discard, learn
from racines_envs.agents.steering import Steering
from racines_envs.agents.training import seeded
from racines_envs.task.core import ScanCore
from racines_envs.task.names import TIERS
from racines_models.devices import on_device, resolve_device
from racines_models.networks.batching import Lasting, in_fixed_batches
from racines_models.networks.servo import Reading, ServoEnsemble, ServoNetwork
from racines_models.protocol import Run
from racines_models.weights import load_network, read_described, save_weights

POLICY = "policy.safetensors"
SLACK = 2.0
"""Squared unit steps that a step has to save after an idle one: what a belief trembles by."""


class ServoAgent:
    """Goes to any view of any patient; it idles, and so declares, where no step helps."""

    name: ClassVar[str] = "servo"
    Config: ClassVar[type] = ServoConfig
    observation: str = "multimodal"
    tiers: ClassVar[tuple[str, ...]] = TIERS[1:]
    beside: ClassVar[frozenset[str]] = frozenset({"processes", "store"})
    """Settings on which nothing that is learned depends: who is done stays so if they change."""

    def __init__(self, config: Any, network: ServoNetwork | ServoEnsemble) -> None:
        """Take a trained network."""
        self.config, self.network = config, network.eval()
        self._device = next(network.parameters()).device

    def attach(self, core: ScanCore) -> None:
        """Take the steps and the workspace of an environment, and learn which view is asked for."""
        if core.task.tier not in self.tiers:
            raise RacinesError(
                f"{self.name} was trained on patients and observes {self.observation} of them; it "
                f"is not for {core.task.id}: use --tier patients or beating"
            )
        self._steering = Steering(core)
        self._label = None if core.task.any_view else core.task.target
        self._task, self._offsets = core.task, waypoints().to(core.device)
        self._mind: Mind | None = None
        self._lasting = Lasting()

    @torch.no_grad()
    def act(self, observation: dict[str, Tensor], seeds: Tensor) -> Tensor:
        """Return the (N,) actions: to where the views are believed, about there, and to rest."""
        pose, labels = self._steering.pose(observation), self._labels(observation)
        same = self._steering.goes_on()
        read, worth = self.read(observation, pose)
        mind = self._mind or self.begun(read)
        mind.learn(read, pose, worth, labels, same)
        mind.search(labels)
        goal, then = self.goals(mind, pose, labels)
        action, reached = self._steering.by_way_of(pose, goal, then, self.slack())
        self.stepped(mind, reached)
        self._mind = mind
        return action

    def begun(self, read: Belief) -> Mind:
        """Begin episodes with a first belief."""
        return Mind.new(read)

    def stepped(self, mind: Mind, reached: Tensor) -> None:
        """Take note of a step; (N,) bool rows have come to where they were going."""
        mind.step(reached)

    def slack(self) -> float | Tensor:
        """Return what a step after an idle one has to save, of all rows or (N,) of each."""
        return SLACK

    def goals(self, mind: Mind, pose: Pose, labels: Tensor) -> tuple[Pose, Pose]:
        """Return (N,) poses to go to from (N,) poses, and those to go to from there."""
        centre = mind.centre(labels)
        goal, then = (mind.goal(centre, further, self._offsets, self._task) for further in (0, 1))
        return goal, then

    def read(self, observation: dict[str, Tensor], pose: Pose) -> tuple[Belief, Tensor]:
        """Return where the images say that the (N,) targets are, and how well they show them."""
        read = self._parted(self._lasting(self._look, observation["image"]))
        label = self._labels(observation)
        each = torch.arange(len(label), device=label.device)
        found = reading(pose, read.ways[each, label], read.deviations[each, label])
        return found, read.scores[each, label] + read.grades[each, label] / 10.0 - 1.0

    def _labels(self, observation: dict[str, Tensor]) -> Tensor:
        """Return the (N,) labels that are looked for."""
        if self._label is None:
            return observation["goal"].argmax(-1)
        poses = observation["params"]
        return torch.full((len(poses),), self._label, device=poses.device)

    def readings(self, images: Tensor) -> Reading:
        """Return what (N, 128, 128) images show of all views."""
        return self._parted(in_fixed_batches(self._look, images))

    def _look(self, images: Tensor) -> Tensor:
        ways, deviations, *shown = self.network.read(self._shrunk(images))
        return torch.cat([ways, deviations, torch.stack(shown, -1)], -1)

    @staticmethod
    def _parted(said: Tensor) -> Reading:
        return Reading(said[..., :6], said[..., 6:12], *said[..., 12:].unbind(-1))

    def _shrunk(self, images: Tensor) -> Tensor:
        """Return (N, side, side) of (N, 128, 128) images, on the network's device."""
        return shrink(images.to(self._device), self.network.side)

    def view_scores(self, images: Tensor) -> Tensor:
        """Return (N, views) scores of (N, 128, 128) float gray levels, to be differentiated."""
        factor = images.shape[-1] // self.network.side
        small = functional.avg_pool2d(images.to(self._device).unsqueeze(1), factor).squeeze(1)
        return self.network.read(small).scores

    @classmethod
    def train(
        cls, config: ServoConfig, run_dir: Path, *, seed: int = 0, resume: bool | None = None,
        progress: bool = True, **where: Any,
    ) -> Self:  # fmt: skip
        """Learn to read, from frames of train patients; arguments as of `LearningAgent.train`."""
        config = on_device(config)
        run = Run(Path(run_dir), seed, config.device, resume, progress)
        with seeded(seed, config.threads):
            network, rounds = learn(config, run, cls)
        metrics = {"training": rounds[0]["training"], "history": rounds[0]["history"]}
        metrics |= {"rounds": rounds[1:], "views": list(VIEWS)}
        save_weights(run.folder / POLICY, network.state_dict())
        told = {"agent": cls.name, "config": asdict(config), "seed": seed}
        write_json(run.folder / SETTINGS, told)
        write_json(run.folder / "metrics.json", metrics)
        discard(run, config.visits.rounds)
        return cls(config, network)

    @classmethod
    def built(cls, config: Any) -> ServoNetwork | ServoEnsemble:
        """Return the network that settings describe, untrained."""
        return ServoNetwork(len(VIEWS), config.widths, config.blocks)

    @classmethod
    def load(cls, run_dir: Path, device: torch.device | str = "cpu") -> Self:
        """Read what `train` left; a policy of another agent is refused."""
        device, remedy = resolve_device(device), f"run `racines train agent {cls.name}`"
        content = read_described(Path(run_dir), f"no trained policy: {remedy}")
        config = cls.described(content, run_dir)
        network = cls.built(config)
        load_network(Path(run_dir) / POLICY, network, remedy)
        return cls(config, network.to(device))

    @classmethod
    def described(cls, content: dict[str, Any], run_dir: Path | str) -> Any:
        """Return the settings of a policy; one of another agent is refused."""
        if content.get("agent") != cls.name:
            raise RacinesError(f"{run_dir}: a policy of {content.get('agent')!r}, not {cls.name}")
        return fill(cls.Config, content["config"], f"{run_dir}/{SETTINGS}")
