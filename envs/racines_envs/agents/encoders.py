"""What an agent may look through: a frozen network that did not learn from reward.

A policy of convolutions from scratch has to find out from reward alone what an image shows, which
takes millions of steps. A pose regressor has learned where an image was taken; a policy that reads
its answer has only the way left to learn. It is given the image alone, in training and after.
"""

from pathlib import Path

from torch import Tensor, nn

from racines_data.errors import RacinesError

PUBLISHED = {"explored": Path("models/weights/encoder"), "pose": Path("models/weights/pose")}
"""What comes with the repository: what `racines train encoder` made of the profile `reference`, and
the pose regressor of the dataset's sweeps, which is lost where tasks start."""
BESIDE = "encoder"
"""Folder beside a policy that holds the encoder's own copy."""


class PoseEncoder(nn.Module):
    """A pose regressor's standardised answer: position (3) and continuous rotation (6)."""

    size = 9

    def __init__(self, network: nn.Module, sha256: str | None) -> None:
        """Take the network of a `PoseRegressor` and the hash of its weights."""
        super().__init__()
        self.network, self.sha256 = network, sha256

    def forward(self, images: Tensor) -> Tensor:
        """Return (B, 9) float32 of (B, 128, 128) gray levels 0-255, any type."""
        return self.network(self.network.normalise(images))  # pyright: ignore[reportCallIssue]


def open_encoder(
    spec: str, device: str = "cpu", near: Path | None = None, sha256: str | None = None
) -> PoseEncoder | None:
    """Return the frozen encoder that a config names; None for "", a policy that learns to see.

    Args:
        spec: `explored` or `pose` (published, see `PUBLISHED`), a folder of another, or "".
        device: Where it runs.
        near: Folder of a policy; a copy of the encoder in it goes first.
        sha256: Hash of the weights that are wanted. The copy, the folder, then the published ones
            are searched for them; without it the first of these that is there is taken.

    Raises:
        RacinesError: no pose regressor there, or none of the hash.
    """
    if not spec:
        return None
    from racines_models.judges.pose.regressor import PoseRegressor

    named = PUBLISHED.get(spec, Path(spec))
    beside = [near / BESIDE] if near is not None else []
    found = [folder for folder in (*beside, named) if folder.is_dir()]
    if sha256 is not None:
        found += [folder for folder in PUBLISHED.values() if folder.is_dir()]
    if not found:
        raise RacinesError(
            f"encoder {spec!r}: no pose regressor in {named}: run from the repository, train one "
            "with `racines train encoder`, or name its folder"
        )
    for folder in found:
        regressor = PoseRegressor.load(folder, device)
        if sha256 is None or regressor.sha256 == sha256:
            return PoseEncoder(regressor.network, regressor.sha256)
    searched = ", ".join(dict.fromkeys(map(str, found)))
    raise RacinesError(
        f"{near or spec}: the policy was trained with another encoder (sha256 {sha256}) than is in "
        f"{searched}; put that one into {near or spec}/{BESIDE}"
    )
