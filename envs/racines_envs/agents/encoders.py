"""What an agent may look through: a frozen network that did not learn from reward.

A policy of convolutions from scratch has to find out from reward alone what an image shows, which
takes millions of steps. A pose regressor has learned where an image was taken; a policy that reads
its answer has only the way left to learn. It is given the image alone, in training and after.
"""

from pathlib import Path

from torch import Tensor, nn

from racines_data.errors import RacinesError

PUBLISHED = {"pose": Path("models/weights/pose")}
"""What comes with the repository: the pose regressor of the dataset's sweeps, which is lost where
tasks start; `racines train encoder` trains one that is not."""
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


def open_encoder(spec: str, device: str = "cpu", near: Path | None = None) -> PoseEncoder | None:
    """Return the frozen encoder that a config names; None for "", a policy that learns to see.

    Args:
        spec: `pose` for the published regressor, a folder of one, or "".
        device: Where it runs.
        near: Folder of a policy; a copy of the encoder in it goes first.

    Raises:
        RacinesError: no pose regressor there.
    """
    if not spec:
        return None
    from racines_models.pose_regressor import PoseRegressor

    beside = near / BESIDE if near else None
    folder = PUBLISHED.get(spec, Path(spec))
    if beside is not None and beside.is_dir():
        folder = beside
    if not folder.is_dir():
        raise RacinesError(
            f"encoder {spec!r}: no pose regressor in {folder}: run from the repository, train one "
            "with `racines train encoder`, or name its folder"
        )
    regressor = PoseRegressor.load(folder, device)
    return PoseEncoder(regressor.network, regressor.sha256)
