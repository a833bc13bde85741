"""What all our generators share: checked input, a card, and files that hold no code."""

import dataclasses
import json
from abc import ABC, abstractmethod
from importlib.metadata import version
from pathlib import Path
from typing import Any, ClassVar, Generic, Self, TypeVar

import torch
from torch import Tensor

from racines_data.config import fill
from racines_data.errors import RacinesError
from racines_data.files import write_json
from racines_data.imaging import IMAGE_SIZE, conditions_for
from racines_data.manifest import UNKNOWN_SCALE
from racines_data.store.frames import FrameStore
from racines_models.contract import ContractError
from racines_models.devices import resolve_device
from racines_models.networks.painting import OnnxModule
from racines_models.protocol import Adapting, Card, Run
from racines_models.provenance import dataset_card
from racines_models.training.checkpoint import discard_checkpoint
from racines_models.training.objective import Validation
from racines_models.training.processes import is_main_process
from racines_models.weights import load_weights, read_described, save_weights

SCHEMA = "racines.generator/1"
NOMINAL = 1e-3
"""Metres that a pixel is taken for where the scale is not known: sizes in settings are in metres,
and only need to be right to a factor of two. Nothing is told in it."""
TOLD = ("name", "title", "summary", "source")
"""What every generator says of itself, in words."""
C = TypeVar("C")


class BaseGenerator(ABC, Generic[C]):
    """Saves tensors and a config; a subclass says what to learn and how to draw."""

    name: ClassVar[str]
    Config: ClassVar[type]
    title: ClassVar[str]
    summary: ClassVar[str]
    source: ClassVar[str]
    stochastic: ClassVar[bool] = False
    conditional: ClassVar[bool] = True
    trained: ClassVar[bool] = True
    limits: ClassVar[tuple[str, ...]] = ()
    holds: ClassVar[tuple[str, ...]] = ()
    """Names of the tensors in `held`, where a method has no networks."""

    config: C

    def __init__(self, config: C | None = None):
        self.config = self.Config() if config is None else config
        self.device = "cpu"
        self.seed = 0
        self.data: dict[str, Any] = {}
        self.held: dict[str, Tensor] = {}

    @property
    def identity(self) -> dict[str, Any]:
        """What is trained on what: only a run of equal identity is continued."""
        card = self.card
        return {"name": card.name, "config": card.config, "seed": card.seed, "data": card.data}

    @property
    def phased(self) -> bool:
        """Whether it is conditioned on the phase of the beat: its training data know that."""
        return bool(self.data.get("phase"))

    @property
    def metres(self) -> float:
        """Metres of a unit of the positions; of a scale that is not known, a pixel is 1 mm."""
        return NOMINAL if self.data.get("scale") == UNKNOWN_SCALE else 1.0

    @abstractmethod
    def learn(self, store: FrameStore, run: Run) -> dict[str, Any]:
        """Learn from the train split and return metrics."""

    @abstractmethod
    def draw(self, parameters: Tensor, seed: int | Tensor) -> Tensor:
        """Return (B, 128, 128) uint8 images of checked parameters on `self.device`.

        (B, 12); if it is `phased`, (B, 13), the phase last.
        """

    def tensors(self) -> dict[str, Tensor]:
        """Return what the model file holds; empty before the fit."""
        return self.held

    def restore(self, tensors: dict[str, Tensor]) -> None:
        """Take back what `tensors` returned, which lies on `self.device`."""
        self.held = {name: tensors[name] for name in self.holds}

    def onnx_module(self) -> OnnxModule:
        """Return the fitted network, as it is exported; override to allow that."""
        raise RacinesError(
            f"{self.name} cannot be an ONNX file: its method is no network of pose and noise; "
            "export its predictions instead: racines export predictions"
        )

    def fit(self, store: FrameStore, run: Run) -> dict[str, Any]:
        """Learn from the train split, let one process save into the folder; return the metrics."""
        if len(store.split_indices("train")) == 0:
            raise RacinesError("the dataset has no train frames: rebuild it with more trajectories")
        self._check_told()
        self.device = resolve_device(run.device)
        run = dataclasses.replace(run, device=self.device)
        self.seed = run.seed
        self.data = dataset_card(store)
        metrics: dict[str, Any] = {"schema": "racines.training/1", "generator": self.name}
        learned = self.learn(store, run)
        if is_main_process():  # first: what was learned stays, whatever it tells and draws
            self._check_held()
            self.save(run.folder)
        metrics |= self._checked(learned)
        if not is_main_process():
            return metrics
        metrics["validation"] = self.look_back(store, run)
        write_json(run.folder / "metrics.json", metrics)
        discard_checkpoint(run.folder)
        return metrics

    def look_back(self, store: FrameStore, run: Run) -> dict[str, Any]:
        """Draw some validation frames after the fit; return figures, leave `samples.png`."""
        return Validation(store, run.seed).look(self, run.folder / "samples.png")

    @torch.no_grad()
    def generate(self, parameters: Tensor, seed: int | Tensor) -> Tensor:
        """Return (B, 128, 128) uint8 images, on the parameters' device (see `ImageSource`)."""
        if not self.tensors():
            raise RacinesError(f"{self.name} is not fitted: call fit, or load a trained folder")
        checked = conditions_for(parameters, self.phased, self.name)
        checked = checked.to(self.device, torch.float32)
        drawn = self.draw(checked, seed)
        wanted = len(checked), IMAGE_SIZE, IMAGE_SIZE
        if not isinstance(drawn, Tensor) or drawn.dtype != torch.uint8 or drawn.shape != wanted:
            kind = type(drawn).__name__
            if isinstance(drawn, Tensor):
                kind = f"a tensor of {drawn.dtype} and shape {tuple(drawn.shape)}"
            found = f"{type(self).__name__}.draw gave {kind}; wanted: uint8 0-255, shape {wanted}"
            raise ContractError("G1", found)
        return drawn.to(parameters.device)

    def _check_told(self) -> None:
        """Refuse a class that lacks a word of its card, before it learns for hours."""
        lacking = [each for each in TOLD if not isinstance(getattr(self, each, None), str)]
        if lacking:
            raise RacinesError(
                f"generator {self.name}: {type(self).__name__} lacks {', '.join(lacking)}: give "
                "each as a class attribute, a text"
            )

    def _checked(self, learned: Any) -> dict[str, Any]:
        """Return the metrics that `learn` gave, if they can be written."""
        where = f"generator {self.name}: {type(self).__name__}"
        if not isinstance(learned, dict):
            kind = type(learned).__name__
            raise RacinesError(f"{where}.learn gave {kind}: give a mapping of metrics, or {{}}")
        try:
            json.dumps(learned)
        except (TypeError, ValueError) as error:
            raise RacinesError(f"{where}.learn: metrics are numbers and texts: {error}") from error
        return learned

    def _check_held(self) -> None:
        """Refuse to save what is no tensor."""
        for name, each in self.tensors().items():
            if not isinstance(each, Tensor):
                raise RacinesError(
                    f"generator {self.name}: {type(self).__name__}.tensors: {name!r} is "
                    f"{type(each).__name__}: give tensors, of a network those of its state_dict()"
                )

    @property
    def card(self) -> Card:
        """Describe the fitted generator."""
        told = ("name", "title", "summary", "source", "stochastic", "data", "seed", "limits")
        told += ("conditional", "trained")
        return Card(
            adapts=isinstance(self, Adapting),
            weights=sum(tensor.numel() for tensor in self.tensors().values()),
            config=dataclasses.asdict(self.config),  # type: ignore[call-overload]
            **{key: getattr(self, key) for key in told},
        )

    def save(self, folder: Path) -> None:
        """Write `model.safetensors` and `config.json` into the folder."""
        save_weights(folder / "model.safetensors", self.tensors())
        content = {"schema": SCHEMA, "code": {"version": version("racines")}}
        write_json(folder / "config.json", content | dataclasses.asdict(self.card))

    @classmethod
    def load(cls, folder: Path, device: str = "cpu") -> Self:
        """Read what `save` wrote; refuse a damaged model, and one of another generator."""
        absent = f"no trained {cls.name} here; run: racines train generator {cls.name}"
        content = read_described(folder, absent)
        if content.get("schema") != SCHEMA or content.get("name") != cls.name:
            held = f"holds {content.get('name') or 'something else'}, not {cls.name}"
            raise RacinesError(f"{folder}/config.json: {held}; name the generator it holds")
        generator = cls(fill(cls.Config, content["config"], f"{folder}/config.json: config"))
        generator.device = resolve_device(device)
        generator.seed, generator.data = content["seed"], content["data"]
        try:
            generator.restore(load_weights(folder / "model.safetensors", generator.device))
        except Exception as error:
            problem = f"cannot be read: {error}; train {cls.name} again"
            raise RacinesError(f"{folder}/model.safetensors: {problem}") from error
        return generator
