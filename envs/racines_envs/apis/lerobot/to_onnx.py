"""From a checkpoint of LeRobot to an ONNX policy of the agents' board.

    python to_onnx.py CHECKPOINT policy.onnx --view SC

CHECKPOINT is a folder that `lerobot-train` left, `…/checkpoints/last/pretrained_model`, of a policy
`act` that was trained on `racines data export --format lerobot-task`. The graph takes `image`,
uint8 (B, 128, 128), and where the policy reads a state `params`, float32 (B, 9), normalises them as
LeRobot does, and gives `twist`, float32 (B, 6): the first action of each chunk, that is what
`select_action` gives with `n_action_steps=1`. Run it in LeRobot's environment, with `onnx` beside
it; it needs nothing of RACINES.
"""

import argparse
import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

IMAGE, STATE, ACTION = "observation.images.ultrasound", "observation.state", "action"
SIZE, POSE, TWIST = 128, 9, 6
OPSET = 18
SCHEMA = "racines.onnx-policy/1"


class Refused(ValueError):
    """A checkpoint that no policy of the board can be made of."""


class Scaling(nn.Module):
    """LeRobot's normalisation of one feature: (x - shift) / scale, and back."""

    shift: Tensor
    scale: Tensor

    def __init__(self, mode: str, stats: Mapping[str, Any], eps: float, back: bool) -> None:
        """Take a mode (`MEAN_STD`, `MIN_MAX`, `IDENTITY`), statistics, and the processor's eps."""
        super().__init__()
        shift, scale = self._of(mode, stats, eps, back)
        self.register_buffer("shift", shift)
        self.register_buffer("scale", scale)
        self.back = back

    @staticmethod
    def _of(mode: str, stats: Mapping[str, Any], eps: float, back: bool) -> tuple[Tensor, Tensor]:
        def number(name: str) -> Tensor:
            return torch.as_tensor(stats[name], dtype=torch.float32)

        if mode == "IDENTITY" or not stats:
            return torch.zeros(()), torch.ones(())
        if mode == "MEAN_STD":
            return number("mean"), number("std") + (0.0 if back else eps)
        if mode == "MIN_MAX":  # to -1..1
            low, span = number("min"), number("max") - number("min")
            half = torch.where(span == 0, torch.full_like(span, eps), span) / 2
            return low + half, half
        raise Refused(f"normalisation {mode}: use MEAN_STD, MIN_MAX or IDENTITY")

    def forward(self, values: Tensor) -> Tensor:
        """Normalise, or undo it."""
        if self.back:
            return values * self.scale + self.shift
        return (values - self.shift) / self.scale


class BoardPolicy(nn.Module):
    """From what an environment shows to a twist, LeRobot's network between."""

    def __init__(self, policy: nn.Module, scalings: Mapping[str, Scaling]) -> None:
        """Take a policy with `predict_action_chunk`, and how image, state and action are scaled."""
        super().__init__()
        self.policy = policy
        self.image, self.action = scalings[IMAGE], scalings[ACTION]
        self.state = scalings.get(STATE)

    def forward(self, image: Tensor, params: Tensor | None = None) -> Tensor:
        """Return (B, 6) twists, m/s and rad/s, of (B, 128, 128) uint8 and (B, 9) float32."""
        pixels = (image.to(torch.float32) / 255).unsqueeze(1).expand(-1, 3, -1, -1)
        batch = {IMAGE: self.image(pixels)}
        if self.state is not None:
            batch[STATE] = self.state(params)
        chunk = _chunk(self.policy, batch)
        return self.action(chunk[:, 0])


def _chunk(policy: Any, batch: dict[str, Any]) -> Tensor:
    """Return (B, T, 6) normalised actions."""
    return policy.model(batch | {"observation.images": [batch[IMAGE]]})[0]


def check_config(config: Any) -> None:
    """Check that a policy sees what an environment shows and gives twists.

    Raises:
        Refused: another type, ensembling over time, or other inputs and outputs.
    """
    if config.type != "act":
        raise Refused(f"a policy of type {config.type}: only act is known to act by one look")
    if config.temporal_ensemble_coeff is not None:
        raise Refused("temporal_ensemble_coeff is set: a file keeps no memory of earlier chunks")
    seen = {name: tuple(feature.shape) for name, feature in config.input_features.items()}
    given = {name: tuple(feature.shape) for name, feature in config.output_features.items()}
    state = {STATE: (POSE,)} if STATE in seen else {}
    wanted = {IMAGE: (3, SIZE, SIZE), **state}
    if seen != wanted or given != {ACTION: (TWIST,)}:
        raise Refused(
            f"the policy reads {seen} and gives {given}: train it on an export of "
            f"--format lerobot-task, which has {IMAGE} (3, {SIZE}, {SIZE}), {STATE} ({POSE},) and "
            f"{ACTION} ({TWIST},)"
        )


def scalings_of(before: Any, after: Any, names: list[str]) -> dict[str, Scaling]:
    """Return the scalings that the steps of LeRobot's two pipelines hold.

    Raises:
        Refused: a pipeline changes values otherwise, or normalises in a way unknown here.
    """
    found = {}
    known = {"rename_observations_processor", "to_batch_processor", "device_processor"}
    for pipeline, back in ((before, False), (after, True)):
        for step in pipeline.steps:
            kind = getattr(type(step), "_registry_name", type(step).__name__)
            if kind in ("normalizer_processor", "unnormalizer_processor"):
                for name in [ACTION] if back else names:
                    feature = step.features[name]
                    mode = step.norm_map.get(feature.type, "IDENTITY")
                    stats = (step.stats or {}).get(name, {})
                    stats = {key: _shaped(value, name) for key, value in stats.items()}
                    found[name] = Scaling(getattr(mode, "value", mode), stats, step.eps, back)
            elif kind not in known or getattr(step, "rename_map", None):
                raise Refused(f"the checkpoint's processors have a step {kind}: not known here")
    if set(found) != {*names, ACTION}:
        raise Refused(f"the checkpoint's processors scale {sorted(found)}: not {names} and action")
    return found


def _shaped(value: Any, name: str) -> Tensor:
    """Return a statistic as it meets (B, …) values: of an image a number a channel."""
    number = torch.as_tensor(value, dtype=torch.float32)
    return number.reshape(-1, 1, 1) if name == IMAGE else number


def load(folder: Path) -> tuple[BoardPolicy, bool, Any]:
    """Return the network of a checkpoint, whether it reads the pose, and LeRobot's configuration.

    Raises:
        Refused: see `check_config` and `scalings_of`.
    """
    from lerobot.configs import PreTrainedConfig  # pyright: ignore[reportMissingImports]
    from lerobot.policies import factory  # pyright: ignore[reportMissingImports]

    config = PreTrainedConfig.from_pretrained(folder)
    config.device = "cpu"
    check_config(config)
    config.pretrained_backbone_weights = None  # the checkpoint has them
    policy = factory.get_policy_class(config.type).from_pretrained(folder, config=config)
    on_cpu = {"device_processor": {"device": "cpu"}}
    before, after = factory.make_pre_post_processors(
        config, str(folder), preprocessor_overrides=on_cpu, postprocessor_overrides=on_cpu
    )
    names = list(config.input_features)
    return BoardPolicy(policy.eval(), scalings_of(before, after, names)), STATE in names, config


def write(board: BoardPolicy, pose: bool, path: Path, view: str | None, card: Any) -> None:
    """Write a network as an ONNX policy with the board's metadata; whole or not at all."""
    import onnx

    images = torch.randint(0, 256, (2, SIZE, SIZE), dtype=torch.uint8)
    inputs = (images, torch.zeros(2, POSE)) if pose else (images,)
    names = ["image", "params"][: len(inputs)]
    part = path.with_name(f".{path.name}.part")
    batch = {name: {0: "batch"} for name in [*names, "twist"]}
    try:
        with torch.no_grad():
            torch.onnx.export(
                board.eval(), inputs, str(part), input_names=names, output_names=["twist"],
                dynamic_axes=batch, opset_version=OPSET, dynamo=False,
            )  # fmt: skip
        model = onnx.load(str(part))
        told = {"schema": SCHEMA, "name": "lerobot-act", "card": json.dumps(card)}
        told |= {"view": view} if view else {}
        onnx.helper.set_model_props(model, {f"racines.{key}": text for key, text in told.items()})
        onnx.save(model, str(part))
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)


def main(words: list[str] | None = None) -> int:
    """Convert a checkpoint; exit code 1 and the reason where it is refused."""
    about = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    about.add_argument("checkpoint", type=Path, help="folder …/checkpoints/last/pretrained_model")
    about.add_argument("out", type=Path, help="file to write, .onnx")
    about.add_argument("--view", help="the view that it was trained for, e.g. SC")
    given = about.parse_args(words)
    try:
        if not (given.checkpoint / "config.json").is_file():
            raise Refused(f"{given.checkpoint}: no config.json: give a folder pretrained_model")
        board, pose, config = load(given.checkpoint)
        card = {"agent": "lerobot-act", "chunk_size": config.chunk_size, "view": given.view}
        write(board, pose, given.out, given.view, card)
    except Refused as error:
        print(f"to_onnx: {error}", file=sys.stderr)
        return 1
    print(f"{given.out}: sees {'image and pose' if pose else 'image'}, gives twists")
    return 0


if __name__ == "__main__":
    sys.exit(main())
