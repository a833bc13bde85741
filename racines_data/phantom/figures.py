"""Pictures of the phantom for people: the contact sheet of the views."""

from pathlib import Path

import numpy as np
import torch
from matplotlib.figure import Figure

from racines_data.files import write_atomic
from racines_data.geometry import Pose, euler_to_matrix, matrix_to_euler
from racines_data.phantom.model import Phantom
from racines_data.plotting import card_style, encode, show_depth
from racines_data.randomness import normal, sample_seeds
from racines_data.views import RANDOM, VIEW_TITLES

COLUMNS = 6
CANDIDATES = 400


@card_style()
def contact_sheet(phantom: Phantom, out: Path, seed: int = 0) -> None:
    """Draw each view at its nominal pose and at poses of falling grade, and `Random` scans."""
    titles = VIEW_TITLES | {name: title for name, title in phantom.titles.items() if title}
    count = len(phantom.labels)
    figure = Figure(figsize=(COLUMNS * 1.75 + 1.2, count * 1.62 + 0.5))
    pixel = 1e3 * phantom.config.probe.pixel_size
    axes = figure.subplots(count, COLUMNS, squeeze=False)
    for row, name in zip(axes, phantom.labels, strict=True):
        for axis, image, grade in zip(row, *_samples(phantom, name, seed), strict=True):
            axis.imshow(image, cmap="gray", vmin=0, vmax=255)
            if axis is row[0]:
                show_depth(axis, image.shape[0], pixel)
            axis.set_axis_off()
            label = "Random" if name == RANDOM else f"grade {grade:.1f}"
            axis.set_title(label, fontsize=9, fontweight="normal", loc="center", pad=2)
        title = titles.get(name, "").replace(" ", "\n")
        row[0].text(
            -0.12, 0.5, f"{name}\n{title}", fontsize=9.5,
            ha="right", va="center", transform=row[0].transAxes,
        )  # fmt: skip
    figure.subplots_adjust(left=0.14, right=0.995, top=0.97, bottom=0.01, wspace=0.03, hspace=0.14)
    write_atomic(out, encode(figure, gray=True, dpi=130))


def _samples(phantom: Phantom, name: str, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return COLUMNS images and grades: nominal first, then evenly down the grades."""
    random = name == RANDOM
    start = phantom.target(phantom.views[0] if random else name)
    spread = 5.0 if random else 1.0
    draw = normal(sample_seeds(seed, CANDIDATES), 6)
    position = start.position.cpu() + draw[:, :3] * spread * torch.tensor([0.006, 0.006, 0.001])
    angles = matrix_to_euler(start.rotation).cpu() + draw[:, 3:] * spread * 0.09
    if random:
        centre = (phantom.workspace.position_min + phantom.workspace.position_max) / 2
        position[:, :2] = centre[:2].cpu() + draw[:, :2] * torch.tensor([0.04, 0.03])
        position[:, 2] = start.position[0, 2]
        lean = draw[:, 3:] * torch.tensor([0.3, 0.25, 1.5])
        angles = lean + torch.tensor([torch.pi, 0.0, 0.0])
    pose = Pose(position, euler_to_matrix(angles)).to(phantom.device)
    if not random:
        pose = Pose(*(torch.cat([a, b]) for a, b in zip(start, pose, strict=True)))
    truth = phantom.judge(pose)
    shown = truth.view == phantom.labels.index(name)
    hits = (shown & phantom.workspace.contains(pose)).nonzero().squeeze(1)
    if random:
        chosen = hits[:COLUMNS]
    else:
        order = hits[truth.grade[hits].argsort(descending=True)]
        chosen = order[torch.linspace(0, len(order) - 1, COLUMNS).round().long()]
        chosen[0] = 0
    images = phantom.render(Pose(*(x[chosen] for x in pose)), sample_seeds(seed, COLUMNS))
    return images.cpu().numpy(), truth.grade[chosen].cpu().numpy()
