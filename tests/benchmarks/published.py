"""Are the peers that were written again as quick as the published programs? Both, in turns.

python -m tests.benchmarks.published SONOGYM LOTUS docs/results/peers.json

Takes the folders of clones of github.com/SonoGym/SonoGym and github.com/danivelikova/lotus, whose
files are run as they are but for the device. The published programs are handed the slices; the
peers cut theirs themselves.
"""

import subprocess
import sys
import types
from pathlib import Path
from typing import Any

import torch
import yaml
from torch import Tensor
from torch.nn import functional

from racines_data.files import write_json
from tests.benchmarks.peers.convolution import KERNEL, Convolution
from tests.benchmarks.peers.rays import Rays
from tests.benchmarks.peers.slices import LabelVolume
from tests.benchmarks.test_render import BATCH, poses
from tests.benchmarks.turns import in_turns, ratios

SENSORS = "source/spinal_surgery/spinal_surgery/lab/sensors"
MACHINE = "one core of an AMD EPYC (Zen 4), beside other work"
TISSUES = {0: 12, 1: 11, 2: 4, 3: 4, 4: 13, 5: 3, 6: 3}
"""Our labels in LOTUS's numbers, by what they resemble."""


def loaded(path: Path) -> dict[str, Any]:
    """Run a published file on the CPU; what it imports and does not need is empty."""
    stubs = ("pyvista", "pydicom", "torchvision")
    kept = {name: sys.modules.get(name) for name in stubs}
    for name in stubs:
        sys.modules[name] = types.ModuleType(name)
    sys.modules["torchvision"].transforms = types.SimpleNamespace(Resize=Resize)  # type: ignore
    space: dict[str, Any] = {"__name__": path.stem}
    try:
        exec(
            compile(path.read_text(encoding="utf-8").replace("'cuda'", "'cpu'"), path.name, "exec"),
            space,
        )
    finally:
        for name, module in kept.items():
            sys.modules.pop(name)
            if module is not None:
                sys.modules[name] = module
    return space


class Resize:
    """What LOTUS takes of torchvision."""

    def __init__(self, size: tuple[int, int]) -> None:
        """Keep the size."""
        self.size = size

    def __call__(self, image: Tensor) -> Tensor:
        """Return the image at that size."""
        return functional.interpolate(image, self.size, mode="bilinear", antialias=True)


def sonogym(folder: Path, labels: Tensor) -> Any:
    """Return the published convolution of 64 slices, its random maps given."""
    space = loaded(folder / SENSORS / "ultrasound/simulate_US_conv.py")
    config = yaml.safe_load((folder / SENSORS / "cfgs/us_cfg.yaml").read_text())
    config["kernel_size"] = [KERNEL, KERNEL]
    for values in config["label_to_ac_params_dict"].values():
        values |= {key: float(value) for key, value in values.items()}  # 9e6 reads as a word
    simulator = space["USSimulatorConv"](config, "cpu")
    known = torch.tensor(sorted(config["label_to_ac_params_dict"]))
    slices = known[labels % len(known)].float()
    first, second = torch.randn_like(slices), torch.randn_like(slices)
    # As many slow variations as the published code reads: one a slice.
    slow = torch.randn((len(slices), 10, 10))
    return lambda: simulator.simulate_US_image_given_rand_map(slices, first, second, slow, False)


def lotus(folder: Path, labels: Tensor) -> Any:
    """Return the published rendering of 64 slices, one at a time, as it takes them."""
    space = loaded(folder / "models/us_rendering_model.py")
    renderer = space["UltrasoundRendering"](types.SimpleNamespace(debug=False), True)
    mapped = torch.tensor([TISSUES.get(i, 3) for i in range(int(labels.max()) + 1)])[labels]
    return lambda: [renderer(each) for each in mapped]


def main(one: Path, other: Path, out: Path) -> None:
    """Time both pairs in turns and write how many times as long the published programs take."""
    torch.manual_seed(0)
    volume, pose = LabelVolume(), poses(BATCH)
    labels = volume.flat[volume.index(pose, volume.pixels)]
    rays = volume.flat[volume.index(pose, volume.rays)]
    again, generator = Rays(volume), torch.Generator().manual_seed(0)
    convolution = Convolution(volume)
    figures: dict[str, Any] = {}
    for name, folder, sides in (
        ("sonogym", one, (sonogym(one, labels), lambda: convolution.render(pose))),
        ("lotus", other, (lotus(other, rays), lambda: again.render(pose, generator))),
    ):
        with torch.no_grad():
            times = in_turns(dict(zip(("published", "again"), sides, strict=True)), 5)
        each = sorted(ratios(times["published"], times["again"]))
        head = ["git", "-C", str(folder), "rev-parse", "HEAD"]
        commit = subprocess.run(head, capture_output=True, text=True, check=True).stdout.strip()
        figures |= {f"{name}_published_over_again": round(each[len(each) // 2], 2)}
        figures |= {f"{name}_commit": commit[:8]}
    write_json(out, {
        "schema": "racines.figures/1",
        "what": "published simulators against the same written again, 64 slices",
        "command": "python -m tests.benchmarks.published SONOGYM LOTUS docs/results/peers.json",
        "machine": MACHINE,
        "source": "measured once",
        "figures": figures,
    })  # fmt: skip
    print(figures)


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
