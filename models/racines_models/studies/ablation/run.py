"""What each part of the phantom's physics brings: KID to real frames without it.

    variant ──> each heart baked once for all variants of its block ──> poses near the view's
        nominal one ──> frames, masked ──> features ──> KID to random halves of the real set

All variants have the same poses, electronic noise, halves and mask (that of the full phantom), so
that a change of KID is the part's alone. What the halves leave open is the range beside it.
"""

import json
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.files import write_json
from racines_data.geometry import Pose
from racines_data.phantom import PHANTOM_VERSION, Phantom, PhantomConfig
from racines_data.phantom.config import heart_config
from racines_data.randomness import derive, sample_seeds
from racines_models.provenance import code_version, environment, sha256_bytes
from racines_models.sample import Progress
from racines_models.scores import metrics
from racines_models.scores.features import Extractor
from racines_models.studies.realism.poses import JITTER, scattered
from racines_models.studies.realism.report import RealFrames, RealismConfig, common_sector, one_each

SCHEMA = "racines.ablation/1"
PROBED = 3
"""Hearts whose frames decide the mask and the gain without gray map."""
HALVINGS = 12
"""Steps of the search for that gain, from `GAINS`: to 0.01 dB."""
GAINS = (-40.0, 0.0)
OFF = -200.0
"""dB of what is switched off."""
BASE = "full phantom"
NO_GRAY_MAP = "no gray map"


@dataclass(frozen=True)
class Variant:
    """One way to render the population of hearts."""

    name: str
    change: Callable[[PhantomConfig, PhantomConfig], PhantomConfig]
    """From a heart's configuration and the base phantom's to what is rendered instead."""

    def configs(self, base: PhantomConfig, hearts: int) -> list[PhantomConfig]:
        """Return the configuration of each of the hearts 1 … `hearts`."""
        return [self.change(heart_config(base, seed), base) for seed in range(1, hearts + 1)]


def _probe(config: PhantomConfig, base: PhantomConfig, **changes: Any) -> PhantomConfig:
    return replace(config, probe=replace(config.probe, **changes))


def _anatomy(config: PhantomConfig, base: PhantomConfig, function: str) -> PhantomConfig:
    return replace(config, anatomy=f"racines_models.studies.ablation.hearts:{function}")


def gray_map_variant(gain: float) -> Variant:
    """Return the variant without gray map, its gain moved by `gain`, dB."""

    def change(config: PhantomConfig, base: PhantomConfig) -> PhantomConfig:
        return _probe(config, base, gray_map=1.0, gain=config.probe.gain + gain)

    return Variant(NO_GRAY_MAP, change)


_PROBE = {
    "single look": {"looks": 1},
    NO_GRAY_MAP: {"gray_map": 1.0},  # its gain is sought: see gray_map_variant
    "no speckle reduction": {"smoothing": (0.0, 0.0)},
    "no multiple scattering": {"haze": OFF},
    "no reverberation": {"reverberation": OFF},
    "no electronic noise": {"noise": OFF},
    "no side lobes": {"side_lobes": 0.0},
    "no directivity": {"directivity": 0.0},
    "no near-field gain": {"near_gain": 0.0},
}
_TISSUES = ("sheets", "grain", "texture", "layers")
VARIANTS = (
    Variant(BASE, lambda config, base: config),
    *(Variant(name, partial(_probe, **changes)) for name, changes in _PROBE.items()),
    Variant("one scanner setting", lambda config, base: replace(config, probe=base.probe)),
    Variant("no cover", lambda c, base: replace(c, block=replace(c.block, cover=0.0))),
    *(Variant(f"no {part}", partial(_anatomy, function=f"no_{part}")) for part in _TISSUES),
    # Heart 1 is of the population: the canonical one lies in plain gel, which is another change.
    Variant("one form of heart", lambda config, base: replace(config, anatomy_seed=1)),
    Variant("one heart, one setting", lambda config, base: base),
)
"""The full phantom first; those that share its baked blocks next to it."""


def pick_variants(names: list[str] | None) -> list[Variant]:
    """Return the full phantom and the named variants, or all."""
    known = [variant.name for variant in VARIANTS]
    unknown = sorted(set(names or ()) - set(known))
    if unknown:
        raise RacinesError(f"unknown variant {unknown[0]!r}: choose of {', '.join(known[1:])}")
    return [v for v in VARIANTS if not names or v.name in (BASE, *names)]


@dataclass(frozen=True)
class AblationConfig:
    """How much is rendered of each variant."""

    hearts: int = 12
    """Hearts 1 … of the population."""
    poses: int = 8
    """Poses of each."""


class Setting(NamedTuple):
    """What all variants share."""

    base: PhantomConfig
    config: AblationConfig
    realism: RealismConfig


def ablate(
    real: RealFrames,
    variants: list[Variant],
    setting: Setting,
    extractor: Extractor,
    out: Path,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Measure the variants, the full phantom first; return the report.

    It is written to `out`, JSON, after each of them; variants measured there under equal settings
    are kept. `progress` is told of each frame rendered and each one embedded.
    """
    told = progress or (lambda count: None)
    real = one_each(real, 2 * setting.realism.frames)
    full = VARIANTS[0].configs(setting.base, min(PROBED, setting.config.hearts))
    probed = [Phantom(config) for config in full]
    mask, gain = _calibrate(real.images, probed, setting)
    variants = [gray_map_variant(gain) if v.name == NO_GRAY_MAP else v for v in variants]
    content = _head(real, mask, gain, setting, extractor)
    digests = {v.name: _digest(v, content, setting) for v in variants}
    done = _done(out, digests)
    missing = [v for v in variants if v.name not in done]
    told(2 * setting.config.hearts * setting.config.poses * (len(variants) - len(missing)))
    if missing:
        reference = extractor(real.images * mask, told)
        content["real_to_real"] = _halves(reference, None, setting.realism)
        for block in _same_blocks(missing, setting):
            frames = _render(block, setting, probed, told)
            for variant, images in zip(block, frames, strict=True):
                features = extractor(images * mask, told)
                kid = _halves(reference, features, setting.realism)
                done[variant.name] = {"name": variant.name, **kid, "digest": digests[variant.name]}
                write_json(out, _report(content, done))
    else:
        content["real_to_real"] = json.loads(out.read_text(encoding="utf-8"))["real_to_real"]
    report = _report(content, done)
    write_json(out, report)
    return report


def poses_near(phantom: Phantom, view: str, count: int, seed: int) -> Pose:
    """Return `count` poses scattered around the nominal one of a view."""
    position, rotation = phantom.target(view)
    return scattered(Pose(position.expand(count, -1), rotation.expand(count, -1, -1)), seed)


def merge_into(report: Path, ablation: dict[str, Any]) -> None:
    """Write the list of an ablation under `ablation` in a report of `racines study realism`."""
    try:
        content = json.loads(report.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise RacinesError(f"{report}: no readable JSON ({error})") from error
    if not isinstance(content, dict) or not content.get("compared"):
        raise RacinesError(f"{report}: holds no comparison; run: racines study realism --real FILE")
    keys = ("name", "kid", "low", "high", "change", "change_low", "change_high")
    content["ablation"] = [{key: row[key] for key in keys} for row in ablation["ablation"]]
    write_json(report, content)


def _frames(phantom: Phantom, setting: Setting, heart: int) -> Tensor:
    """Return (K, 128, 128) frames of a heart, counted from 0: its poses and noise are its own."""
    config, realism = setting.config, setting.realism
    pose = poses_near(phantom, realism.view, config.poses, realism.seed * 10007 + heart)
    seeds = derive(sample_seeds(realism.seed, config.poses), heart)
    return phantom.render(pose, seeds)


def _render(
    block: list[Variant], setting: Setting, probed: list[Phantom], told: Progress
) -> list[Tensor]:
    """Return (H * K, 128, 128) frames of each of some variants whose volumes are the same."""
    configs = [v.configs(setting.base, setting.config.hearts) for v in block]
    parts: list[list[Tensor]] = [[] for _ in block]
    baked = probed[0]
    for heart in range(setting.config.hearts):
        wanted = configs[0][heart]
        near = probed[heart] if heart < len(probed) else baked
        fitting = [p for p in (near, baked) if _volume_of(p.config) == _volume_of(wanted)]
        baked = fitting[0] if fitting else Phantom(wanted)
        for part, rows in zip(parts, configs, strict=True):
            part.append(_frames(baked.with_probe(rows[heart].probe), setting, heart))
            told(setting.config.poses)
    return [torch.cat(part) for part in parts]


def _volume_of(config: PhantomConfig) -> PhantomConfig:
    """Return what decides the baked block: all but the probe."""
    return replace(config, probe=PhantomConfig().probe)


def _same_blocks(variants: list[Variant], setting: Setting) -> Iterable[list[Variant]]:
    """Return the variants in groups that share the baked block of every heart."""
    groups: dict[tuple[PhantomConfig, ...], list[Variant]] = {}
    for variant in variants:
        configs = variant.configs(setting.base, setting.config.hearts)
        groups.setdefault(tuple(map(_volume_of, configs)), []).append(variant)
    return groups.values()


def _calibrate(real: Tensor, probed: list[Phantom], setting: Setting) -> tuple[Tensor, float]:
    """Return the mask of all variants, and the gain, dB, that keeps the gray without gray map."""

    def render(variant: Variant) -> Tensor:
        changed = [p.with_probe(variant.change(p.config, setting.base).probe) for p in probed]
        return torch.cat([_frames(p, setting, heart) for heart, p in enumerate(changed)])

    full = render(VARIANTS[0])
    mask = common_sector(real, full, setting.realism.support)
    wanted = full[:, mask].double().mean()
    low, high = GAINS
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        brighter = bool(render(gray_map_variant(middle))[:, mask].double().mean() > wanted)
        low, high = (low, middle) if brighter else (middle, high)
    return mask, round((low + high) / 2, 2)


def _halves(real: Tensor, ours: Tensor | None, config: RealismConfig) -> dict[str, Any]:
    """Return KID to random halves of the real set at equal n; of the other halves without ours."""
    random = np.random.default_rng(config.seed)
    n = min(len(real) // 2, config.frames, len(real) if ours is None else len(ours))
    values = []
    for _ in range(config.splits):
        order = random.permutation(len(real))
        other = real[order[n : 2 * n]] if ours is None else ours[random.permutation(len(ours))[:n]]
        values.append(metrics.kid(other, real[order[:n]]))
    mean = sum(values) / len(values)
    return {"kid": mean, "low": min(values), "high": max(values), "values": values}


def _head(
    real: RealFrames, mask: Tensor, gain: float, setting: Setting, extractor: Extractor
) -> dict[str, Any]:
    config, realism = setting.config, setting.realism
    return {
        "schema": SCHEMA,
        "view": realism.view,
        "real": {"sha256": real.sha256, "frames": len(real.images)},
        "hearts": config.hearts,
        "poses": config.poses,
        "jitter": list(JITTER),
        "n": min(len(real.images) // 2, realism.frames, config.hearts * config.poses),
        "splits": realism.splits,
        "seed": realism.seed,
        "mask": {"pixels": int(mask.sum()), "support": realism.support},
        "gain_without_gray_map": gain,
        "phantom_version": PHANTOM_VERSION,
        "extractor": extractor.settings,
        "code": code_version(),
        "environment": environment(),
    }


def _digest(variant: Variant, content: dict[str, Any], setting: Setting) -> str:
    """Return the digest of what decides a variant's KID."""
    free = {k: v for k, v in content.items() if k not in ("code", "environment")}
    configs = variant.configs(setting.base, setting.config.hearts)
    settings = [free, asdict(setting.realism), *map(asdict, configs)]
    return sha256_bytes(json.dumps(settings, sort_keys=True).encode())


def _done(out: Path, digests: dict[str, str]) -> dict[str, dict[str, Any]]:
    """Return the rows of a former run that still hold, by name."""
    try:
        content = json.loads(out.read_text(encoding="utf-8"))
        rows = [content["base"], *content["ablation"]] if content["schema"] == SCHEMA else []
        return {row["name"]: row for row in rows if digests.get(row["name"]) == row["digest"]}
    except (OSError, ValueError, KeyError, TypeError):
        return {}


def _report(content: dict[str, Any], done: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """Return the report: each row with its change from the full phantom over the same halves."""
    base = done[BASE]
    rows = []
    for row in done.values():
        if row["name"] != BASE:
            changes = [a - b for a, b in zip(row["values"], base["values"], strict=True)]
            span = {"change_low": min(changes), "change_high": max(changes)}
            rows.append({**row, "change": row["kid"] - base["kid"], **span})
    return {**content, "base": base, "ablation": sorted(rows, key=lambda row: -row["change"])}


PLATE = {"facecolor": "white", "edgecolor": "none", "pad": 0.8}
"""Behind a figure, where the line of the full phantom crosses it."""


def draw_ablation(content: dict[str, Any]) -> bytes:
    """Return a PNG of the KID of each variant, with the range of its change over the halves."""
    from matplotlib.figure import Figure

    from racines_data.plotting import MUTED, OURS, PAPER, card_style, encode

    rows, base = content["ablation"][::-1], content["base"]
    with card_style():
        figure = Figure(figsize=(7.2, 1.4 + 0.27 * len(rows)), layout="constrained")
        axes = figure.add_subplot()
        kid = [row["kid"] for row in rows]
        below = [row["change"] - row["change_low"] for row in rows]
        above = [row["change_high"] - row["change"] for row in rows]
        colours = [OURS if row["change"] > 0 else MUTED for row in rows]
        names = [row["name"] for row in rows]
        thin = {"elinewidth": 0.8}
        axes.barh(names, kid, 0.66, xerr=[below, above], color=colours, error_kw=thin)
        for i, row in enumerate(rows):
            place = (row["kid"] + above[i], i)
            axes.annotate(f" {row['change']:+.3f}", place, va="center", fontsize=7.5, bbox=PLATE)
        axes.axvline(base["kid"], color=PAPER, linewidth=1.2)
        axes.set_title(f"full phantom {base['kid']:.3f}; bars: range over the halves", color=PAPER)
        axes.grid(visible=False, axis="y")
        axes.margins(x=0.09)
        figures = f"KID to real {content['view']} frames, n = {content['n']}"
        axes.set_xlabel(f"{figures}; lower is nearer")
        return encode(figure)
