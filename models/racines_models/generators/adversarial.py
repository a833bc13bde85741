"""What every generator with a discriminator shares: its networks, and what is kept of them."""

from abc import abstractmethod
from collections.abc import Iterator, Mapping
from typing import Any, ClassVar, TypeVar

from torch import Tensor, nn
from torch.optim import Optimizer

from racines_data.errors import RacinesError
from racines_data.store.frames import FrameStore
from racines_models.generators.base import BaseGenerator
from racines_models.protocol import Run
from racines_models.training.objective import TrainBatch, Update
from racines_models.training.trainer import train

C = TypeVar("C")


class AdversarialGenerator(BaseGenerator[C]):
    """Networks by name, among them `conditioning`, `discriminator` and the one that draws."""

    drawing: ClassVar[str] = "generator"
    """Name of the network that draws; a `Framed` one, fitted to the sector if the config says."""
    stochastic = True

    nets: nn.ModuleDict | None = None

    @abstractmethod
    def build(self) -> nn.ModuleDict:
        """Return the untrained networks, their initial weights drawn from `self.seed`."""

    @abstractmethod
    def modules(self) -> dict[str, nn.Module]:
        """Return the networks that train, by name (see `Learner`)."""

    @abstractmethod
    def averaged(self) -> tuple[str, ...]:
        """Name the networks whose weights are averaged."""

    @abstractmethod
    def optimizers(self) -> dict[str, Optimizer]:
        """Return fresh optimizers by name."""

    @abstractmethod
    def updates(self, nets: Mapping[str, nn.Module], batch: TrainBatch) -> Iterator[Update]:
        """Yield the optimizer steps of one batch, in order."""

    def net(self, name: str) -> Any:
        """Return one of the networks, once there are some."""
        assert self.nets is not None
        return self.nets[name]

    def learn(self, store: FrameStore, run: Run) -> dict[str, Any]:
        """Fit the conditioning and the sector, then train."""
        self.nets = self.build()
        self.net("conditioning").fit(store.parameters[store.split_indices("train")])
        config: Any = self.config
        learner: Any = self  # a `Learner`, once a subclass names it
        if config.sector:
            self.net(self.drawing).fit(store)
        self.nets.to(self.device)
        return train(learner, store, config.training, run)

    def tensors(self) -> dict[str, Tensor]:
        """Return all networks but the discriminator, which stays behind."""
        if self.nets is None:
            return {}
        state = self.nets.state_dict()
        return {key: value for key, value in state.items() if not key.startswith("discriminator")}

    def restore(self, tensors: dict[str, Tensor]) -> None:
        """Take the weights back."""
        self.nets = self.build().to(self.device)
        left = self.nets.load_state_dict(tensors, strict=False)
        missing = [key for key in left.missing_keys if not key.startswith("discriminator")]
        if missing or left.unexpected_keys:
            raise RacinesError(f"{missing or left.unexpected_keys} do not fit the config")
