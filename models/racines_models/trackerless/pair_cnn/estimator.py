"""The learned baseline `pair-cnn`: each step from the frames about it, chained."""

from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, ClassVar

import torch

from racines_data.config import fill
from racines_data.errors import RacinesError
from racines_data.files import sha256_file, write_json
from racines_data.imaging import check_images
from racines_models.devices import resolve_device
from racines_models.networks.batching import in_fixed_batches
from racines_models.protocol import Run
from racines_models.provenance import code_version, environment
from racines_models.trackerless.motion import Motion, steps
from racines_models.trackerless.pair_cnn.network import PairConfig, PairNetwork, windows
from racines_models.trackerless.pair_cnn.training import train_network
from racines_models.trackerless.sweeps import Shown, SweepSet
from racines_models.training.checkpoint import discard_checkpoint
from racines_models.weights import load_network, read_described, save_weights

WEIGHTS, CONFIG = "model.safetensors", "config.json"
SCHEMA = "racines.pair-cnn/1"


class PairCnn:
    """Estimates each step from the frames about it, and chains the steps.

    A step depends on its own window alone, to the last bit, on one machine.
    """

    name: ClassVar[str] = "pair-cnn"
    Config: ClassVar[type] = PairConfig
    trained: ClassVar[bool] = True
    told_first: ClassVar[bool] = False

    def __init__(self, config: PairConfig | None = None) -> None:
        """Take the settings; `fit` or `load` brings the network."""
        self.config = config or PairConfig()
        self.network: PairNetwork | None = None
        self.device = torch.device("cpu")
        self.learned_from: dict[str, Any] = {}
        self.sha256: str | None = None
        """Hash of the weights' file; None until saved or loaded."""

    def fit(self, sweeps: SweepSet, run: Run) -> dict[str, Any]:
        """Train on the train split, save, and return the metrics on validation sweeps.

        Raises:
            RacinesError: no training sweeps, or `run.resume` is True and nothing can be resumed.
        """
        run = replace(run, device=resolve_device(run.device))
        network, metrics = train_network(sweeps, self.config, run)
        self.take(network, run.device).learned_from = dict(sweeps.card)
        made = {"data": dict(sweeps.card), "seed": run.seed, "code": code_version()}
        self.save(run.folder, **made)
        metrics = {"schema": "racines.pair-cnn-metrics/1"} | made | metrics
        metrics |= {"environment": environment(run.device)}
        write_json(run.folder / "metrics.json", metrics)
        discard_checkpoint(run.folder)
        return metrics

    def take(self, network: PairNetwork, device: str) -> "PairCnn":
        """Use a network from now on."""
        self.device = torch.device(resolve_device(device))
        self.network = network.to(self.device).eval().requires_grad_(False)
        return self

    @torch.inference_mode()
    def estimate(self, shown: Shown) -> Motion:
        """Return the motion of a sweep of T frames."""
        images, network = check_images(shown.images), self.network
        if network is None:
            raise RacinesError("pair-cnn: no network yet; run: racines train motion pair-cnn")
        places = windows(torch.arange(1, len(images)), self.config.window, 0)
        found = in_fixed_batches(
            lambda batch: network(network.normalise(batch)), images[places].to(self.device)
        )
        return steps(found.cpu().double())

    def save(self, folder: Path, **provenance: Any) -> None:
        """Write `model.safetensors`, then `config.json` with what `provenance` adds."""
        assert self.network is not None
        self.sha256 = save_weights(folder / WEIGHTS, self.network.state_dict())
        files = {WEIGHTS: {"bytes": (folder / WEIGHTS).stat().st_size, "sha256": self.sha256}}
        described = {"schema": SCHEMA, "name": self.name, "config": asdict(self.config)}
        described |= {"weights_files": {"dtype": "float32", "files": files}}
        write_json(folder / CONFIG, described | provenance)

    @classmethod
    def load(cls, folder: Path, device: str = "cpu") -> "PairCnn":
        """Read what `save` wrote; refused if absent or damaged."""
        absent = "no pair-cnn there; run: racines train motion pair-cnn"
        described = read_described(Path(folder), absent, SCHEMA)
        config = fill(PairConfig, described["config"], f"{folder / CONFIG}: config")
        network = PairNetwork(config)
        load_network(folder / WEIGHTS, network, f"run: racines train motion pair-cnn ({folder})")
        found = cls(config).take(network, device)
        found.learned_from = described.get("data") or {}
        found.sha256 = sha256_file(folder / WEIGHTS)
        return found
