"""Configuration of the phantom: block, probe, contact and workspace; metres, seconds, newtons."""

from dataclasses import dataclass, field

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
