"""What generators share that learn by gradients: their networks, and those of an adversary."""

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar, TypeVar

import torch
from torch import Tensor, nn

from racines_data.errors import RacinesError
from racines_data.randomness import sample_seeds
from racines_data.store.frames import FrameStore
from racines_models.generators.base import BaseGenerator
from racines_models.networks.batching import in_fixed_batches
from racines_models.networks.layers import Conditioning
from racines_models.networks.painting import Framed, NoiseInput, OnnxModule, Painter
from racines_models.networks.pyramid import Discriminator
from racines_models.protocol import Run
from racines_models.training.trainer import train

DRAW = 3
"""Random stream of an adversarial generator: its noise at drawing."""
C = TypeVar("C")


class NetworkGenerator(BaseGenerator[C]):
    """Networks by name that the trainer trains; a subclass is their `Learner`, and its own."""

    unsaved: ClassVar[tuple[str, ...]] = ()
    """Networks that stay behind once they are trained."""
    fitted: ClassVar[tuple[str, ...]] = ()
    """Networks that `prepare` fits, and that training leaves as they are."""
    memory_format: ClassVar[torch.memory_format] = torch.channels_last
    """The faster order on CPU and GPU; fixed here, since orders round apart."""

    nets: nn.ModuleDict | None = None

    @abstractmethod
    def untrained(self) -> Mapping[str, nn.Module]:
        """Return the untrained networks by name, in the order that fixes their initial weights."""

    @abstractmethod
    def prepare(self, store: FrameStore) -> None:
        """Take what stays fixed in training from the train split."""

    def build(self) -> nn.ModuleDict:
        """Return the untrained networks, their initial weights drawn from `self.seed`."""
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(self.seed)
            nets = nn.ModuleDict(self.untrained())
        return nets.to(memory_format=self.memory_format)  # type: ignore[call-overload]

    def net(self, name: str) -> Any:
        """Return one of the networks, once there are some."""
        assert self.nets is not None
        return self.nets[name]

    def modules(self) -> dict[str, nn.Module]:
        """Return the networks that train, by name."""
        assert self.nets is not None
        return {name: net for name, net in self.nets.items() if name not in self.fitted}

    def averaged(self) -> tuple[str, ...]:
        """Name those that are saved."""
        return tuple(name for name in self.modules() if name not in self.unsaved)

    def learn(self, store: FrameStore, run: Run) -> dict[str, Any]:
        """Take what stays fixed, then train."""
        learner: Any = self
        self.nets = self.build()
        self.prepare(store)
        self.nets.to(self.device)
        return train(learner, store, learner.config.training, run)

    def draw(self, parameters: Tensor, seed: int | Tensor) -> Tensor:
        """Draw as an exported file does: with noise of each sample's seed, if there is any."""
        module = self.onnx_module()
        network, noise = module.network.eval(), module.noise
        if noise is None:
            return in_fixed_batches(network, parameters)
        seeds = sample_seeds(seed, len(parameters), parameters.device)
        return in_fixed_batches(
            lambda parameters, seeds: network(parameters, noise.draw(seeds)), parameters, seeds
        )

    def tensors(self) -> dict[str, Tensor]:
        """Return what the networks learned."""
        state = {} if self.nets is None else self.nets.state_dict()
        return {key: value for key, value in state.items() if not key.startswith(self.unsaved)}

    def restore(self, tensors: dict[str, Tensor]) -> None:
        """Take the weights back."""
        self.nets = self.build().to(self.device)
        left = self.nets.load_state_dict(tensors, strict=False)
        missing = [key for key in left.missing_keys if not key.startswith(self.unsaved)]
        if missing or left.unexpected_keys:
            raise RacinesError(f"{missing or left.unexpected_keys} do not fit the config")


class AdversarialGenerator(NetworkGenerator[C]):
    """Networks among which are `conditioning`, `discriminator` and the one that draws."""

    drawing: ClassVar[str] = "generator"
    """Name of the network that draws; it turns noise and condition into (B, 1, 128, 128)."""
    fitted, unsaved = ("conditioning",), ("discriminator",)
    stochastic = True

    @abstractmethod
    def networks(self, condition: int) -> Mapping[str, nn.Module]:
        """Return the networks that train, for a condition of that width."""

    def untrained(self) -> Mapping[str, nn.Module]:
        """Return the networks, the one that draws behind the sector's stencil."""
        config: Any = self.config
        conditioning = Conditioning(config.conditioning, self.phased)
        nets = {"conditioning": conditioning, **self.networks(conditioning.width)}
        return nets | {self.drawing: Framed(nets[self.drawing])}

    def discriminator(self, condition: int, **kind: Any) -> Discriminator:
        """Return the adversary that the config describes, of some kind of layers."""
        config: Any = self.config
        judging = {key: getattr(config.adversary, key) for key in ("joining", "normalisation")}
        sizes = config.discriminator_width, condition, config.embedding
        return Discriminator(*sizes, **judging, **kind)

    def prepare(self, store: FrameStore) -> None:
        """Fit the conditioning, and the sector if the config says so."""
        config: Any = self.config
        self.net("conditioning").fit(store.conditions(store.split_indices("train")))
        if config.sector:
            self.net(self.drawing).fit(store)

    def onnx_module(self) -> OnnxModule:
        """Return conditioning and the network that draws."""
        network = self.net(self.drawing)
        painter = Painter(self.net("conditioning"), network)
        return OnnxModule(painter, NoiseInput(network.noise, (DRAW,)))
