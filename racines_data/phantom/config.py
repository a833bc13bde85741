"""Configuration of the phantom: block, probe, contact and workspace; metres, seconds, newtons.

With it, what one seed of the population makes of a configuration, and the one of a dataset.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from racines_data.config import fill
from racines_data.errors import RacinesError
from racines_data.imaging import IMAGE_SIZE
from racines_data.manifest import MULTI_PHANTOM
from racines_data.randomness import sample_seeds, uniform

PHANTOM_VERSION = "1.0.0"
"""Part of every recipe digest: raise it whenever an image, a force or a truth changes."""


@dataclass(frozen=True)
class BlockConfig:
    """The gel block, axis-aligned in the robot base frame."""

    minimum: tuple[float, float, float] = (0.400, -0.060, -0.075)
    maximum: tuple[float, float, float] = (0.580, 0.092, 0.065)
    """The top face is the scanned surface; 18 x 15.2 x 14 cm."""
    voxel: float = 0.001
    """Edge of a voxel of the baked volume, m."""
    seed: int = 0
    """Draws the scatterers; the same block has the same scatterers for ever."""
    cover: float = 0.0
    """Unevenness of what lies over the organ, dB/cm/MHz over 8 mm: it throws soft shadows."""


@dataclass(frozen=True)
class ProbeConfig:
    """A phased-array sector probe and its scanner settings."""

    half_angle: float = 0.68
    """Half the sector angle, rad."""
    depth: float = 0.155
    """Imaging depth, m."""
    beams: int = 96
    samples: int = 144
    """Samples along a beam."""
    frequency: float = 2.5
    """Centre frequency, MHz."""
    axial_sigma: float = 0.0006
    """Standard deviation of the pulse envelope, m."""
    lateral_sigma: float = 0.012
    """Standard deviation of the beam at the focus, rad (about half of λ/D)."""
    focus: float = 0.075
    """Focal depth, m; the beam widens towards the probe."""
    side_lobes: float = 0.05
    """Amplitude of the side lobes relative to the main lobe: bright walls haze the chambers."""
    side_lobe_sigma: float = 0.22
    """Angular spread of the side lobes, rad."""
    directivity: float = 7.0
    """Two-way loss of a beam steered to the sector's edge, dB: elements hear less from aside."""
    elevation_sigma: float = 0.012
    """Half-thickness of the slice, m per m of depth."""
    aperture: float = 0.020
    """Width of the probe's face along x, m."""
    thickness: float = 0.012
    """Width of the face along y, m."""
    gain: float = -7.5
    """Gain, dB: moves the gray of myocardium."""
    dynamic_range: float = 68.0
    """Log compression, dB from black to white."""
    gray_map: float = 2.2
    """Exponent of the gray map after log compression: above 1 it calms the dark, as scanners do."""
    looks: int = 2
    """Frequency compounding: sub-bands whose compressed pictures are averaged."""
    smoothing: tuple[float, float] = (0.3, 0.8)
    """Speckle reduction on the compressed picture, as scanners do: samples along a beam, beams."""
    near_gain: float = -7.0
    """Gain at the face against that in depth, dB, as operators turn the near field down."""
    haze: float = -26.0
    """Multiple scattering, dB below the mean echo around: a fine veil over chambers and walls."""
    reverberation: float = -24.0
    """Echoes that bounced in the layers under the probe, dB below myocardium at the face."""
    noise: float = -50.0
    """Electronic noise at the face, dB below myocardium; TGC lifts it with depth."""

    @property
    def pixel_size(self) -> float:
        """The side of a picture's pixel, m."""
        return 2.0 * self.depth * math.sin(self.half_angle) / IMAGE_SIZE


@dataclass(frozen=True)
class ContactConfig:
    """Contact of the probe with the gel, and what the wrist sensor feels of it."""

    stiffness: float = 1600.0
    """Normal stiffness, N/m."""
    hardening: float = 90_000.0
    """Second-order stiffness, N/m²."""
    friction: float = 0.75
    """Coulomb friction coefficient of the gelled probe."""
    slip_speed: float = 0.004
    """Speed at which friction saturates, m/s."""
    lever: float = 0.19
    """From the wrist sensor to the probe's tip, m."""
    torsion: float = 0.043
    """Friction torque about the beam axis, N·m a newton of normal force."""
    spin_speed: float = 0.05
    """Yaw rate at which torsion saturates, rad/s."""
    tool_weight: float = 2.2
    """Weight left after the sensor is zeroed looking down, N."""
    tool_centre: float = 0.09
    """Height of that weight above the tip, m."""
    offset: tuple[float, float, float, float, float, float] = (0.6, -1.5, -0.9, -0.22, 0.29, 0.1)
    """What the sensor reads beside contact and weight: the cable's pull and drift, N and N·m."""


@dataclass(frozen=True)
class WorkspaceConfig:
    """Where the probe may go; beyond it a pose is refused or a step becomes idle."""

    margin: float = 0.012
    """Distance of the tip from the block's edges, m."""
    lowest: float = 0.040
    highest: float = 0.134
    """Height of the tip, m (the paper's range of position_z)."""
    press: float = 17.0
    """Normal force at which the robot's protective limit holds an operator back, N."""
    tilt_max: float = 1.0
    """Angle between the beam axis and straight down, rad."""
    yaw_max: float = 2.5
    """Largest |rotation_z|, rad."""


@dataclass(frozen=True)
class PhantomConfig:
    """Everything that decides what the phantom shows."""

    anatomy: str = "heart"
    """Name of an anatomy (entry points `racines.anatomies`)."""
    anatomy_seed: int = 0
    """0 is the canonical organ; other seeds give other organs of the same kind."""
    block: BlockConfig = field(default_factory=BlockConfig)
    probe: ProbeConfig = field(default_factory=ProbeConfig)
    contact: ContactConfig = field(default_factory=ContactConfig)
    workspace: WorkspaceConfig = field(default_factory=WorkspaceConfig)


_STREAM = 41
_SPREAD = {
    "gain": 5.0,  # dB
    "dynamic_range": 10.0,  # dB
    "gray_map": 0.4,
    "noise": 6.0,  # dB
    "reverberation": 6.0,  # dB
    "haze": 7.0,  # dB: what differs most from one patient to the next
}
"""How far an examination's settings stray from the base probe's, either way."""
COVER = 2.5  # most unevenness of the cover, dB/cm/MHz


def heart_config(base: PhantomConfig, seed: int) -> PhantomConfig:
    """Return the phantom of heart `seed`, 1 or more: its scatterers and its examiner differ too."""
    cover = COVER * uniform(sample_seeds(seed, 1), 1, _STREAM + 1).item()
    block = replace(base.block, seed=base.block.seed + 10 * seed, cover=cover)
    draw = uniform(sample_seeds(seed, 1), len(_SPREAD), _STREAM)[0].tolist()
    strayed = {
        name: getattr(base.probe, name) + spread * (2.0 * x - 1.0)
        for (name, spread), x in zip(_SPREAD.items(), draw, strict=True)
    }
    return replace(base, anatomy_seed=seed, block=block, probe=replace(base.probe, **strayed))


def phantom_settings(manifest: Mapping[str, Any], config: str) -> dict[str, Any] | None:
    """Return the phantom's settings and version as the recipe names them; None for others."""
    recipe = manifest.get("recipe") or {}
    part = recipe.get(MULTI_PHANTOM if config == MULTI_PHANTOM else "settings") or {}
    settings = (part.get("acquisition") or {}).get("phantom")
    return settings and {"version": part.get("phantom"), "phantom": settings}


def recorded_phantom(manifest: dict[str, Any]) -> PhantomConfig:
    """Return the phantom of a dataset; `RacinesError` if it has none, or one of another version."""
    found = phantom_settings(manifest, "frames")
    if found is None:
        raise RacinesError(
            f"the dataset's source is {manifest.get('source')}: only a simulated "
            "phantom can be scanned again; leave noise-ceiling out of `generators`"
        )
    if found["version"] != PHANTOM_VERSION:
        raise RacinesError(
            f"the dataset is of phantom {found['version']}, this is phantom "
            f"{PHANTOM_VERSION}: build it again with racines data build"
        )
    return fill(PhantomConfig, found["phantom"], "manifest.json: recipe: phantom")
