"""What training images are varied by: mildly, the scanner; strongly, all that a simulator is not.

`augment` keeps label and grade. A mirrored heart is another view, so nothing is flipped, turned or
moved; and a shadow is poor coupling, which lowers the true grade, so none is drawn.

`strengthen` is for a judge that is to be asked about real frames. It has parts that are switched on
by name, so that an ablation can leave out one of them. It moves masks with their images and keeps
views; grades too, but where a shadow lowers them.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Tensor
from torch.nn import functional

from racines_data.errors import RacinesError
from racines_data.randomness import normal, uniform

SCANNER, NOISE, CHOICES, CHOSEN = 0, 1, 2, 3
"""Random streams of one image."""
PARTS = ("rotation", "scale", "sector", "blur", "gain", "speckle", "haze", "shadow", "negatives")
"""Parts of the strong augmentation, in the order in which they act; each has a random stream."""
STREAMS = {name: 10 * (place + 1) for place, name in enumerate(PARTS)}


@dataclass(frozen=True)
class Augmentation:
    """How strongly training images vary; 0 switches a part off."""

    gain: float = 0.1
    """Standard deviation of the log of a gain, one an image."""
    tgc: float = 0.05
    """Standard deviation of the log of a gain that grows linearly with depth, at the far end;
    the near end gets its inverse (time-gain compensation)."""
    gamma: float = 0.05
    """Standard deviation of the log of an exponent on the gray levels."""
    blur: float = 0.2
    """Share of the images that are blended with their 3 x 3 mean, by a uniform weight."""
    erase: float = 0.1
    """Share of the images with a black box (random erasing, Zhong et al., 2020)."""
    erase_side: float = 0.2
    """Largest side of the box as a share of the image's."""
    noise: float = 0.02
    """Standard deviation of pixel noise, 1 = white."""


def augment(x: Tensor, seeds: Tensor, config: Augmentation) -> Tensor:
    """Vary (B, 1, S, S) images in [-1, 1] by (B,) seeds, each by its own; black stays black."""
    light = (x + 1.0) / 2.0
    tissue = light > 0
    scanner = normal(seeds, 3, SCANNER).unbind(-1)
    choices = uniform(seeds, 6, CHOICES)
    if config.blur:
        weight = torch.where(choices[:, 0] < config.blur, choices[:, 1], 0.0).view(-1, 1, 1, 1)
        mean = functional.avg_pool2d(light, 3, stride=1, padding=1, count_include_pad=False)
        light = light.lerp(mean, weight)
    if config.gamma:
        light = light.clamp_min(1e-6).pow((config.gamma * scanner[2]).exp().view(-1, 1, 1, 1))
    depth = torch.linspace(-1.0, 1.0, x.shape[-2], device=x.device)
    slope = config.tgc * scanner[1].unsqueeze(-1) * depth
    gain = (config.gain * scanner[0].unsqueeze(-1) + slope).exp()
    light = light * gain.view(len(x), 1, -1, 1)
    if config.noise:
        light = light + config.noise * normal(seeds, x[0].numel(), NOISE).view(x.shape)
    if config.erase:  # a box of half to the whole largest side
        size = x.shape[-1]
        half = size * config.erase_side * (0.25 + 0.25 * choices[:, 3])
        half = torch.where(choices[:, 2] < config.erase, half, -1.0).unsqueeze(-1)
        place = torch.arange(size, device=x.device) + 0.5
        down = (place - size * choices[:, 4:5]).abs() < half
        right = (place - size * choices[:, 5:6]).abs() < half
        tissue = tissue & ~(down.unsqueeze(-1) & right.unsqueeze(-2)).unsqueeze(1)
    light = light.clamp(0.0, 1.0) * tissue
    return (light * 2.0 - 1.0).contiguous(memory_format=torch.channels_last)


@dataclass(frozen=True)
class StrongAugmentation:
    """How far simulated images are taken from the simulator, so that real ones lie among them."""

    parts: tuple[str, ...] = ()
    """Those that are on: rotation, scale, sector, blur, gain, speckle, haze, shadow, negatives."""
    share: float = 1.0
    """Of the images that are varied strongly; the others stay as simulated, and what is learned
    from them is exact."""
    rotation: float = 12.0
    """Largest turn about the apex, degrees: the probe rocked in the plane of the image."""
    scale: float = 0.25
    """Largest change of the log of the depth of the image, about the apex; across, a fifth more."""
    sector: float = 0.35
    """Share of its angle, of its depth and of a sixth of the width by which a sector is cut."""
    blur: float = 1.0
    """Largest weight of a 5 x 5 blur."""
    gain: float = 0.3
    """Standard deviation of the logs of gamma and contrast; half of it, of a gain by depth."""
    speckle: float = 0.12
    """Largest standard deviation of grain of one to three pixels, 1 = white."""
    haze: float = 0.6
    """Largest brightness of a cloud, densest near the probe."""
    shadow: float = 0.8
    """Largest share of the light that each of two bands of beams may lose, as behind ribs."""
    negatives: float = 0.15
    """Share of the images that become what no view is: upside down, on the side, shuffled."""

    def __post_init__(self) -> None:
        """Refuse a part that is not known, and a share that is none."""
        if not 0.0 <= self.share <= 1.0:
            raise RacinesError(f"strong.share {self.share:g}: give 0 to 1")
        for name in self.parts:
            if name not in PARTS:
                raise RacinesError(f"strong.parts: no part {name!r}; choose of {', '.join(PARTS)}")


def strengthen(
    x: Tensor, seeds: Tensor, config: StrongAugmentation, masks: Tensor | None = None
) -> tuple[Tensor, Tensor | None]:
    """Vary (B, 1, S, S) images in [-1, 1] by (B,) seeds, each by its own.

    Args:
        x: images with the apex at the top centre; what is black stays so.
        seeds: (B,) int64.
        config: which parts, and how strongly.
        masks: (B, H, W) uint8 labels; they are moved and cut as the images are, and keep their
            labels where light is changed.

    Returns:
        Images and masks of the same shapes.
    """
    if config.share < 1.0:
        return _some(x, seeds, config, masks)
    light, on = (x + 1.0) / 2.0, config.parts
    theta, cut = _motion(seeds, config), config.sector if "sector" in on else 0.0
    if any(name in on for name in ("rotation", "scale", "sector")):
        light = _moved(light, theta, "bilinear") * _sector(light, seeds, cut)
        if masks is not None:
            labels = masks.unsqueeze(1).float()
            moved = _moved(labels, theta, "nearest") * _sector(labels, seeds, cut)
            masks = moved.squeeze(1).to(masks.dtype)
    tissue = light > 0
    for name, change in LIGHT.items():
        if name in on:
            light = change(light, seeds, getattr(config, name))
    light = light.clamp(0.0, 1.0) * tissue
    return (light * 2.0 - 1.0).contiguous(memory_format=torch.channels_last), masks


def _some(
    x: Tensor, seeds: Tensor, config: StrongAugmentation, masks: Tensor | None
) -> tuple[Tensor, Tensor | None]:
    """Vary a share of the images, each of which its seed chooses."""
    chosen = uniform(seeds, 1, CHOSEN)[:, 0] < config.share
    varied, moved = strengthen(x, seeds, replace(config, share=1.0), masks)
    x = torch.where(chosen.view(-1, 1, 1, 1), varied, x)
    if masks is not None and moved is not None:
        masks = torch.where(chosen.view(-1, 1, 1), moved, masks)
    return x.contiguous(memory_format=torch.channels_last), masks


def spoil(x: Tensor, seeds: Tensor, config: StrongAugmentation) -> tuple[Tensor, Tensor]:
    """Turn some of (B, 1, S, S) images into what shows no view; return them and (B,) bool, which.

    What a network says of them is a matter of what it was taught, so these are its negatives.
    """
    u = uniform(seeds, 2, STREAMS["negatives"])
    chosen = u[:, 0] < (config.negatives if "negatives" in config.parts else 0.0)
    kind = (u[:, 1] * 4).long()
    order = uniform(seeds, 16, STREAMS["negatives"] + 1).argsort(1)
    changed = (x.flip(-2), x.mT, x.mT.flip(-1), _shuffled(x, order))
    for place, each in enumerate(changed):
        x = torch.where((chosen & (kind == place)).view(-1, 1, 1, 1), each, x)
    return x.contiguous(memory_format=torch.channels_last), chosen


def _shuffled(x: Tensor, order: Tensor) -> Tensor:
    """Let the 4 x 4 blocks of (B, 1, S, S) images change places, by (B, 16) permutations."""
    side = x.shape[-1] // 4
    blocks = functional.unfold(x, side, stride=side)
    blocks = blocks.gather(2, order.unsqueeze(1).expand_as(blocks))
    return functional.fold(blocks, (4 * side, 4 * side), side, stride=side)


def _motion(seeds: Tensor, config: StrongAugmentation) -> Tensor:
    """Return (B, 2, 3) maps from where a pixel lands to where it comes from, about the apex."""

    def drawn(name: str, count: int) -> Tensor:
        strength = getattr(config, name) if name in config.parts else 0.0
        return strength * (2.0 * uniform(seeds, count, STREAMS[name]) - 1.0)

    angle = torch.deg2rad(drawn("rotation", 1)[:, 0])
    depth, across = drawn("scale", 2).unbind(1)
    shift = drawn("sector", 2) / 3.0  # a sixth of the width, which is 2
    ys = (-depth).exp()
    xs = ys * (-across / 5.0).exp()
    cos, sin = angle.cos(), angle.sin()
    linear = torch.stack(
        [torch.stack([cos * xs, -sin * ys], 1), torch.stack([sin * xs, cos * ys], 1)], 1
    )
    apex = linear.new_tensor([0.0, -1.0])
    lands = apex + torch.stack([shift[:, 0], shift[:, 1].abs() / 2.0], 1)
    offset = apex - (linear @ lands.unsqueeze(-1)).squeeze(-1)
    return torch.cat([linear, offset.unsqueeze(-1)], -1)


def _moved(x: Tensor, theta: Tensor, mode: str) -> Tensor:
    grid = functional.affine_grid(theta, list(x.shape), align_corners=False)
    return functional.grid_sample(x, grid, mode, "zeros", align_corners=False)


def _polar(x: Tensor) -> tuple[Tensor, Tensor]:
    """Return (H, W) angles from the vertical, rad, and depths from the top centre, 1 = height."""
    across = (torch.arange(x.shape[-1], device=x.device) + 0.5) * 2.0 / x.shape[-1] - 1.0
    down = (torch.arange(x.shape[-2], device=x.device) + 0.5) / x.shape[-2]
    down, across = torch.meshgrid(down, across / 2.0, indexing="ij")
    return torch.atan2(across, down), across.hypot(down)


def _sector(x: Tensor, seeds: Tensor, strength: float) -> Tensor:
    """Return (B, 1, H, W) 0 or 1: the inside of sectors of other angles and depths."""
    u = uniform(seeds, 5, STREAMS["sector"] + 1)
    angle, depth = _polar(x)
    widest = math.radians(50.0)
    half = widest * (1.0 - strength * u[:, :2]) + widest * (u[:, 4:] < 0.3)
    far = 1.2 * (1.0 - strength * u[:, 2])
    inside = (angle > -half[:, :1, None]) & (angle < half[:, 1:, None])
    return (inside & (depth < far.view(-1, 1, 1))).unsqueeze(1).to(x.dtype)


def _blurred(light: Tensor, seeds: Tensor, strength: float) -> Tensor:
    soft = light
    for _ in range(2):
        soft = functional.avg_pool2d(soft, 3, stride=1, padding=1, count_include_pad=False)
    weight = strength * uniform(seeds, 1, STREAMS["blur"])
    return light.lerp(soft, weight.view(-1, 1, 1, 1))


def _brightened(light: Tensor, seeds: Tensor, strength: float) -> Tensor:
    drawn = strength * normal(seeds, 6, STREAMS["gain"])
    gamma, contrast = drawn[:, :2].exp().view(-1, 2, 1, 1, 1).unbind(1)
    size = light.shape[-2]
    by_depth = functional.interpolate(drawn[:, None, 2:], size, mode="linear", align_corners=True)
    return light.clamp_min(1e-6).pow(gamma) * contrast + by_depth.view(-1, 1, size, 1) / 2.0


def _grained(light: Tensor, seeds: Tensor, strength: float) -> Tensor:
    size, stream = light.shape[-1], STREAMS["speckle"]
    fine = normal(seeds, size * size, stream).view(light.shape)
    small = normal(seeds, (size // 2) ** 2, stream + 1).view(-1, 1, size // 2, size // 2)
    coarse = functional.interpolate(small, (size, size), mode="bilinear")
    amount, share = uniform(seeds, 2, stream + 2).view(-1, 2, 1, 1, 1).unbind(1)
    return light + strength * amount * fine.lerp(coarse, share)


def _hazy(light: Tensor, seeds: Tensor, strength: float) -> Tensor:
    drawn = uniform(seeds, 18, STREAMS["haze"])
    size = light.shape[-2:]
    cloud = functional.interpolate(drawn[:, 2:].view(-1, 1, 4, 4), size, mode="bicubic")
    reach = (0.2 + 0.8 * drawn[:, 1]).view(-1, 1, 1, 1)
    density = cloud.clamp(0.0, 1.0) * torch.exp(-_polar(light)[1] / reach)
    return light + strength * drawn[:, 0].view(-1, 1, 1, 1) * density * (1.0 - light)


def _shaded(light: Tensor, seeds: Tensor, strength: float) -> Tensor:
    angle, depth = _polar(light)
    for drawn in uniform(seeds, 10, STREAMS["shadow"]).view(-1, 2, 5).unbind(1):
        middle, width, start, loss, there = drawn.view(-1, 5, 1, 1).unbind(1)
        off = (angle - 1.6 * (middle - 0.5)) / (0.03 + 0.12 * width)
        band = torch.exp(-off.square()) * (depth > 0.5 * start) * (there < 0.5)
        light = light * (1.0 - strength * loss * band).unsqueeze(1)
    return light


LIGHT: dict[str, Callable[[Tensor, Tensor, float], Tensor]] = {
    "blur": _blurred,
    "gain": _brightened,
    "speckle": _grained,
    "haze": _hazy,
    "shadow": _shaded,
}
"""What changes the light alone."""
