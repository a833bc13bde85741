"""What in an image moved a decision, and how good such an answer is.

Attributions are Integrated Gradients from a black image (Sundararajan et al., Axiomatic Attribution
for Deep Networks, 2017; Captum's implementation). They are scored by deletion and insertion, beside
random maps, and by overlap with what truly lies in an image: the phantom's tissues and landmarks on
the image plane.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from racines_data.errors import RacinesError
from racines_data.extras import needed
from racines_data.geometry import Pose, rotate
from racines_data.imaging import IMAGE_SIZE
from racines_data.phantom.acoustics import pixel_grid, sector_mask
from racines_data.phantom.anatomy import load_anatomy
from racines_data.phantom.config import ProbeConfig
from racines_data.randomness import normal, sample_seeds
from racines_data.world import World
from racines_envs.agents.protocol import encoder_of
from racines_models.judges.grader.model import Grader
from racines_models.protocol import Judge

Explained = Callable[[Tensor, Tensor], Tensor]
"""(B, 128, 128) float images, gray levels 0-255, and (B, 9) parameters -> (B, outputs)."""
BATCH = 256
"""Images at once in a backward pass."""
POINTS = 24
"""Images of a curve, the first and the last included."""
BLUR = 5.0
"""Standard deviation of the blur that insertion starts from, pixels."""
SMOOTH = 4.0
"""Standard deviation of the blur of the smooth random maps, pixels."""
TOP = 0.1
"""Share of the sector's pixels that count as the top of a map."""
WALL = 2
"""Pixels on each side of a change of tissue that count as its border."""
_STREAM = 211


def policy_logits(agent: Any) -> Explained:
    """Return an agent's scores of the 13 actions as a function of its image, if it has such."""
    name, observation = getattr(agent, "name", type(agent).__name__), agent.observation
    if observation == "params":
        raise RacinesError(
            f"agent {name!r} looks at no image (observation 'params'), and an explanation is of "
            "images: train one with --observation image or multimodal"
        )
    if not hasattr(agent, "logits"):
        raise RacinesError(
            f"agent {name!r} has no logits(observation) to differentiate: only learned policies "
            "(such as ppo) can be explained"
        )
    if getattr(agent, "encoder", None) is not encoder_of(agent):
        raise RacinesError(
            f"agent {name!r} goes by what all images of an episode told it: no one image's pixels "
            "explain a step"
        )
    for network in (getattr(agent, "actor", None), getattr(agent, "encoder", None)):
        if network is not None:
            network.eval().requires_grad_(False)

    def judge(images: Tensor, params: Tensor) -> Tensor:
        pose = {"params": params} if observation == "multimodal" else {}
        return agent.logits({"image": images} | pose)

    return judge


def view_scores(agent: Any) -> Explained:
    """Return how sure an agent that reads views is of each, as a function of its image.

    Raises:
        RacinesError: an agent that reads none.
    """
    if not hasattr(agent, "view_scores"):
        name = getattr(agent, "name", type(agent).__name__)
        raise RacinesError(f"agent {name!r} reads no views of an image: explain its actions")
    agent.network.eval().requires_grad_(False)

    def judge(images: Tensor, params: Tensor) -> Tensor:
        return agent.view_scores(images)

    return judge


def grader_probabilities(grader: Judge) -> Explained:
    """Return a grader's probabilities of the views as a function of the image, if it is ours."""
    if not isinstance(grader, Grader):
        raise RacinesError(f"grader {grader!r} has no network to differentiate: give a run folder")
    network = grader.network

    def judge(images: Tensor, params: Tensor) -> Tensor:
        logits, _ = network(network.normalise(images.to(grader.device)))
        return (logits / grader.temperature).softmax(-1)

    return judge


def integrated_gradients(
    judge: Explained, images: Tensor, params: Tensor, targets: Tensor, steps: int = 50
) -> tuple[Tensor, Tensor]:
    """Attribute one output an image to its pixels, from a black image.

    `images` are (N, 128, 128) uint8, `params` (N, 9) and held fixed, `targets` (N,) int64, which
    output of each, `steps` the points of the integral (Gauss-Legendre).

    Returns:
        (N, 128, 128) float32 attributions, and the (N,) completeness error: their sum less the
        difference of the outputs between image and black image, which would be 0 with an exact
        integral.
    """
    needed("captum", "integrated gradients")
    from captum.attr import IntegratedGradients

    method, found = IntegratedGradients(judge), []
    parts = zip(images.split(BATCH), params.split(BATCH), targets.split(BATCH), strict=True)
    for part, given, wanted in parts:
        black = torch.zeros_like(part, dtype=torch.float32)
        attributed = method.attribute(
            part.float(), baselines=black, target=wanted, additional_forward_args=(given,),
            n_steps=steps, internal_batch_size=BATCH, return_convergence_delta=True,
        )  # fmt: skip
        found.append(attributed)
    maps, errors = (torch.cat(column).detach().float() for column in zip(*found, strict=True))
    return maps, errors


@torch.no_grad()
def outputs(judge: Explained, images: Tensor, params: Tensor) -> Tensor:
    """Return (N, outputs) of (N, 128, 128) images of any type."""
    parts = zip(images.split(BATCH), params.split(BATCH), strict=True)
    return torch.cat([judge(part.float(), given) for part, given in parts])


def blur(images: Tensor, sigma: float) -> Tensor:
    """Blur (N, H, W) float images by a Gaussian."""
    radius = int(3 * sigma + 0.5)
    offset = torch.arange(-radius, radius + 1, device=images.device)
    kernel = torch.exp(-0.5 * (offset / sigma) ** 2)
    kernel = kernel / kernel.sum()
    padded = functional.pad(images.unsqueeze(1), [radius] * 4, mode="replicate")
    across = functional.conv2d(padded, kernel.view(1, 1, 1, -1))
    return functional.conv2d(across, kernel.view(1, 1, -1, 1)).squeeze(1)


def random_maps(shape: torch.Size, seed: int, sigma: float = 0.0) -> Tensor:
    """Draw (N, H, W) maps of noise, blurred by `sigma` pixels: as ragged or smooth as wanted."""
    seeds = sample_seeds(seed, shape[0])
    noise = normal(seeds, shape[1] * shape[2], _STREAM).view(shape)
    return blur(noise, sigma) if sigma else noise


def ranks(maps: Tensor, sector: Tensor) -> Tensor:
    """Return the (N, H, W) order of the pixels in 0-1, the most important first; 2 outside.

    Pixels outside the (H, W) sector are black in every image and never taken.
    """
    order = maps[:, sector].argsort(dim=1, descending=True, stable=True)
    place = torch.full_like(maps, 2.0, dtype=torch.float32)
    place[:, sector] = order.argsort(dim=1).float() / order.shape[1]
    return place


def areas(
    judge: Explained, images: Tensor, params: Tensor, targets: Tensor, maps: Tensor, sector: Tensor,
    insert: bool, logits: bool,
) -> np.ndarray:  # fmt: skip
    """Return the (N,) areas under the deletion or insertion curves.

    Deletion blackens the most important pixels first, insertion puts them into a blurred image
    (Petsiuk et al., RISE, 2018). The curve is the probability of the target output over the share
    of the sector's pixels. A good map has a small area in deletion and a large one in insertion.

    `images` are (N, 128, 128) uint8, `params` (N, 9) and held fixed, `targets` (N,) int64, `maps`
    (N, 128, 128) and large where important, `sector` (128, 128) bool. `insert`: insertion, or else
    deletion. `logits`: outputs are logits, to be turned into probabilities.
    """
    place, full = ranks(maps, sector), images.float()
    empty = blur(full, BLUR) * sector if insert else torch.zeros_like(full)
    curve = []
    for share in torch.linspace(0.0, 1.0, POINTS):
        taken = place < share
        shown = torch.where(taken == insert, full, empty)
        found = outputs(judge, shown, params)
        found = found.softmax(-1) if logits else found
        curve.append(found.gather(1, targets.unsqueeze(1)).squeeze(1))
    height = torch.stack(curve).double()
    return ((height[:-1] + height[1:]) / 2).mean(0).cpu().numpy()


def overlap(maps: Tensor, region: Tensor, sector: Tensor) -> tuple[np.ndarray, np.ndarray]:
    """Return where the top of (N, H, W) maps lies, which are large where important.

    The (N,) share of the top tenth of the (H, W) sector's pixels that lies in the (N, H, W) bool
    region, and the (N,) share of the sector that the region is: what a map that knows nothing would
    have.
    """
    region = region & sector
    top = ranks(maps, sector) < TOP
    hit = (top & region).flatten(1).sum(1) / top.flatten(1).sum(1)
    chance = region.flatten(1).sum(1) / sector.sum()
    return hit.cpu().numpy(), chance.cpu().numpy()


def sector_of(world: World) -> Tensor:
    """Return the (128, 128) bool mask of the sector; everything where the probe is unknown."""
    if world.config is None:
        return torch.ones(IMAGE_SIZE, IMAGE_SIZE, dtype=torch.bool)
    return sector_mask(world.config.probe)


def plane_points(probe: ProbeConfig, pose: Pose) -> Tensor:
    """Return the (N, 128, 128, 3) points of the block under the pixels, base frame, m."""
    lateral, axial = (x.float() for x in pixel_grid(probe))
    local = torch.stack([lateral, torch.zeros_like(lateral), axial], -1)
    turned = rotate(pose.rotation.cpu()[:, None, None], local)
    return turned + pose.position.cpu()[:, None, None]


def true_regions(world: World, pose: Pose, view: str) -> dict[str, Tensor]:
    """Return named (N, 128, 128) bool regions of the images at (N,) poses.

    `organ`: not the gel around it. `borders`: within two pixels of a change of tissue. `landmarks`:
    inside the spheres of the structures that the view has to show. Empty for a stand-in phantom
    without an anatomy.
    """
    config = world.config
    if config is None:
        return {}
    anatomy = load_anatomy(config.anatomy, config.anatomy_seed)
    axes, origin = torch.tensor(anatomy.axes), torch.tensor(anatomy.origin)
    points = (plane_points(config.probe, pose) - origin) @ axes.T
    tissue = torch.stack([anatomy.paint(p.reshape(-1, 3)) for p in points])
    tissue = tissue.view(points.shape[:-1])
    wanted = {name for name, _ in next(v for v in anatomy.views if v.name == view).structures}
    landmarks = torch.zeros_like(tissue, dtype=torch.bool)
    for structure in anatomy.structures:
        if structure.name in wanted:
            away = (points - torch.tensor(structure.centre)).norm(dim=-1)
            landmarks |= away < structure.radius
    level, size = tissue.float().unsqueeze(1), 2 * WALL + 1
    highest = functional.max_pool2d(level, size, 1, WALL)
    lowest = -functional.max_pool2d(-level, size, 1, WALL)
    borders = (highest != lowest).squeeze(1)
    return {"organ": tissue != 0, "borders": borders, "landmarks": landmarks}
