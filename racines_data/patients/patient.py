# pyright: strict
"""What is known of a patient: records of numbers, which `dataclasses.asdict` turns into JSON."""

from dataclasses import dataclass

PATIENTS_VERSION = "0.5.0"
"""Of this world, apart from the phantom's: raise it whenever an image, a force or a truth moves."""

PATHOLOGIES = ("healthy", "dilated", "hypertrophied", "small", "atria", "right")
"""Normal; dilated or hypertrophied LV, small heart, enlarged atria, dilated RV."""


@dataclass(frozen=True)
class Body:
    """Who is examined."""

    female: bool
    height: float  # m
    weight: float  # kg
    surface: float  # m² (Mosteller)


@dataclass(frozen=True)
class Form:
    """The heart at end diastole, millimetres."""

    ventricle: float  # LV, inside, across
    length: float  # LV, inside, mitral plane to apex
    oval: float  # ratio of the LV's two widths
    oval_turn: float  # rad, where the wider one points, from the lateral wall
    waviness: float  # share by which the LV's endocardium strays from an oval
    septum: float  # thickness
    wall: float  # thickness of the LV's other walls
    right: float  # RV, inside, across the base
    right_length: float  # RV, against the norm
    left_atrium: float  # across, from front to back
    right_atrium: float  # across
    root: float  # aortic sinuses
    outflow: float  # RVOT, distal
    papillary: float  # thickness of the papillary muscles, against the norm


@dataclass(frozen=True)
class Place:
    """Where the heart lies."""

    x: float  # from the middle of the field, m, base frame
    y: float
    clearance: float  # between chest wall and heart, m
    turn: float  # about the vertical, rad
    tilt: float  # rad
    tilt_way: float  # direction of the tilt's axis, rad


@dataclass(frozen=True)
class Chest:
    """The chest wall over the heart."""

    thickness: float  # m
    fat: float  # share of the thickness
    rib_spacing: float  # from rib to rib, m
    rib_width: float  # m
    rib_loss: float  # of sound that crosses a rib, dB one way
    lung_loss: float  # the same in lung, dB
    notch: float  # radius of what the lung leaves free around the windows, m
    slope: float  # of the ribs against the crosswise direction, rad
    cover: float  # by which uneven fat and muscle dim and brighten beams, dB one way


@dataclass(frozen=True)
class Tissues:
    """How the tissues scatter."""

    surroundings: float  # backscatter against myocardium, dB
    unevenness: float  # its slow variation, dB
    grain: float  # its fine variation, dB
    layers: float  # share that is layers of connective tissue
    liver: float  # backscatter, dB
    blood: float  # backscatter, dB
    patchiness: float  # slow variation of the walls, dB
    valves: float  # backscatter of leaflets, dB


@dataclass(frozen=True)
class Examination:
    """What the examiner chose at the scanner."""

    half_angle: float  # of the sector, rad
    margin: float  # depth beyond what holds the heart, share
    gain: float  # dB
    dynamic_range: float  # dB
    gray_map: float
    noise: float  # dB
    reverberation: float  # dB
    haze: float  # dB
    near_gain: float  # dB
    far_gain: float  # at the sector's end against its middle, dB
    grain: float  # of the finished picture, gray levels


@dataclass(frozen=True)
class Motion:
    """How the heart beats and the chest breathes."""

    emptying: float  # share of the LV's blood that a normally moving wall would eject
    right_emptying: float
    shortening: float  # descent of the base, mm
    atrial: float  # widening of the atria in systole, share
    kick: float  # share of the filling that the atria do
    weak: float  # 0-1, loss of motion in a region
    weak_at: float  # its direction round the LV, rad
    weak_height: float  # its middle, share of the LV's length
    rate: float  # beats a minute
    variation: float  # standard deviation of a beat's length, share
    early: float  # share of beats that come early
    breath: float  # s a breath
    sway: float  # of the heart with breathing, m, head to foot


@dataclass(frozen=True)
class Patient:
    """One patient; `dataclasses.asdict` is JSON."""

    seed: int
    pathology: str
    body: Body
    form: Form
    place: Place
    chest: Chest
    tissues: Tissues
    examination: Examination
    motion: Motion
