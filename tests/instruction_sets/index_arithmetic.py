"""What index arithmetic draws the phantom alike on every processor: the table of docs/validate.md.

    python -m tests.instruction_sets.index_arithmetic 256      # poses of each scene; minutes

Each instruction set draws in a process of its own, with the renderer's voxel index put in another
way, and with the voxels that `default` baked in place of its own. Nothing of it is in the product.
"""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import torch
from torch import Tensor

from racines_data.geometry import Pose, parameters_to_pose
from racines_data.phantom import Phantom, acoustics
from racines_data.phantom.acoustics import Beams
from racines_data.phantom.volume import Volume
from racines_data.randomness import sample_seeds, uniform
from racines_leaderboard.determinism.processors import POSES, SCENES, choose_poses

SETS = "default", "avx2", "avx512"
REACH = torch.tensor([0.006, 0.006, 0.001, 0.1, 0.1, 0.2])  # about the canonical poses: m, rad
CHUNK = 16
Index = Callable[[Volume, Beams, Phantom, Pose], Tensor]


def directions(phantom: Phantom, pose: Pose) -> Tensor:
    """Return the (B, L, 3) float64 directions of the beams of float64 poses."""
    probe = phantom.config.probe
    angle = torch.linspace(-probe.half_angle, probe.half_angle, probe.beams, dtype=torch.float64)
    x, z = (pose.rotation[:, None, :, i] for i in (0, 2))
    return x * angle.sin().view(1, -1, 1) + z * angle.cos().view(1, -1, 1)


def in_float64(volume: Volume, beams: Beams, phantom: Phantom, pose: Pose) -> Tensor:
    """Return the (B, L, S) voxels with everything in float64."""
    index, direction, scale = None, directions(phantom, pose), volume.voxel
    for axis, size in enumerate(volume.shape):
        start = (pose.position[:, axis] - volume.origin[axis].double()) / scale + 0.5
        where = direction[..., axis : axis + 1] * (beams.depth.double() / scale)
        where = where + beams.elevation.double() * (pose.rotation[:, axis, 1] / scale).view(
            -1, 1, 1
        )
        where = (where + start.view(-1, 1, 1)).clamp(0.0, size - 1.0).to(torch.int32)
        index = where if index is None else index * size + where
    assert index is not None
    return index


def in_integers(volume: Volume, beams: Beams, phantom: Phantom, pose: Pose) -> Tensor:
    """Return the (B, L, S) voxels in int32: start 2^-20 voxel, direction 2^-14, depth 2^-6."""

    def rounded(values: Tensor, bits: int) -> Tensor:
        return (values.double() * 2**bits).round().to(torch.int32)

    index, direction = None, rounded(directions(phantom, pose), 14)
    depth, aside = (
        rounded(beams.depth / volume.voxel, 6),
        rounded(beams.elevation / volume.voxel, 6),
    )
    for axis, size in enumerate(volume.shape):
        start = (pose.position[:, axis] - volume.origin[axis].double()) / volume.voxel + 0.5
        where = direction[..., axis : axis + 1] * depth
        where += aside * rounded(pose.rotation[:, axis, 1], 14).view(-1, 1, 1)
        where = ((where + rounded(start, 20).view(-1, 1, 1)) >> 20).clamp(0, size - 1)
        index = where if index is None else index * size + where
    assert index is not None
    return index


WAYS: dict[str, tuple[Index | None, bool]] = {
    "as it is, float32": (None, False),
    "pose and index in float64": (in_float64, False),
    "pose in float64, index in 32-bit integers": (in_integers, False),
    "as it is, but voxels baked once": (None, True),
    "index in 32-bit integers, and voxels baked once": (in_integers, True),
}


def draw(count: int, folder: Path) -> None:
    """Draw `count` poses of each scene in every way, and keep images and voxels in a file."""
    torch.set_num_threads(1)
    name = torch.backends.cpu.get_cpu_capability().lower()
    found = {}
    for number, ((scene, config), rows) in enumerate(
        zip(SCENES.items(), torch.load(folder / "poses.pt").split(POSES), strict=True)
    ):
        phantom, baked = Phantom(config), folder / f"{number}.pt"
        if name == "default":
            torch.save(phantom._volume.packed, baked)
        about = 2.0 * uniform(sample_seeds(number, count), 6, 78) - 1.0
        parameters = rows[torch.arange(count) % POSES].clone()
        parameters[:, 6:] += REACH * about
        mine = phantom._volume.packed
        for way, (index, shared) in WAYS.items():
            packed = torch.load(baked) if shared else mine
            phantom._volume = phantom._volume._replace(packed=packed)
            parts = [_render(phantom, part, index) for part in parameters.split(CHUNK)]
            found[scene, way] = tuple(torch.cat(each) for each in zip(*parts, strict=True))
    torch.save(found, folder / f"{name}.pt")


OWN = acoustics._voxel_index


def _render(phantom: Phantom, parameters: Tensor, index: Index | None) -> tuple[Tensor, Tensor]:
    """Return the images of (B, 12) parameters and the voxel under each sample."""
    voxels, exact = [], parameters_to_pose(parameters.double())

    def look(volume: Volume, beams: Beams, *plain: Tensor) -> Tensor:
        voxels.append(index(volume, beams, phantom, exact) if index else OWN(volume, beams, *plain))
        return voxels[-1]

    acoustics._voxel_index = look
    images = phantom.render(parameters_to_pose(parameters), torch.arange(len(parameters)))
    acoustics._voxel_index = OWN
    return images, torch.cat(voxels)


def main(count: int) -> None:
    """Print, for each way, how far the instruction sets are apart."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        torch.save(torch.from_numpy(choose_poses().parameters), folder / "poses.pt")
        for each in SETS:
            words = [sys.executable, "-m", __spec__.name, str(count), name]
            subprocess.run(words, env=os.environ | {"ATEN_CPU_CAPABILITY": each}, check=True)
        drawn = {each: torch.load(folder / f"{each}.pt") for each in SETS}
    for way in WAYS:
        for one, other in (("default", "avx2"), ("default", "avx512"), ("avx2", "avx512")):
            pairs = [(drawn[one][s, way], drawn[other][s, way]) for s in SCENES]
            apart = torch.cat([(a[0].int() - b[0].int()).abs().flatten() for a, b in pairs])
            flips = sum(int((a[1] != b[1]).sum()) for a, b in pairs)
            samples = sum(a[1].numel() for a, _ in pairs)
            print(
                f"{way}, {one} and {other}: {flips} of {samples} samples in another voxel, "
                f"{int((apart > 0).sum())} of {len(apart)} pixels differ, "
                f"{int((apart > 1).sum())} by more than 1, {int(apart.max())} at most",
                flush=True,
            )


if __name__ == "__main__":
    if len(sys.argv) > 2:
        draw(int(sys.argv[1]), Path(sys.argv[2]))
    else:
        main(int(sys.argv[1]))
