# pyright: strict
"""What differs from row to row when a batch is rendered, as tensors: one line a patient.

The polar grid is the same for all: 96 beams and 144 samples, whatever the sector's width and depth.
So its point spread function, a matrix, is shared, and a deeper sector is scanned with a longer
pulse, as scanners do.
"""

import math
from dataclasses import replace
from typing import NamedTuple

import torch
from torch import Tensor

from racines_data.imaging import IMAGE_SIZE
from racines_data.patients.form import Shape
from racines_data.patients.labels import ATTENUATIONS, SOFT
from racines_data.patients.patches import patches_of
from racines_data.patients.patient import Patient
from racines_data.patients.placement import Placement
from racines_data.phantom.acoustics import NEAR_FIELD, RINGING_DEPTH
from racines_data.phantom.config import ProbeConfig

PROBE = replace(ProbeConfig(), lateral_sigma=0.014, smoothing=(0.5, 1.1), directivity=3.5)
"""Face, beams, samples and pulse of the one probe; width, depth and gains are a patient's."""
SOFT_LOSS = ATTENUATIONS[0] + SOFT * ATTENUATIONS[1]  # dB/cm/MHz, which the TGC undoes

MIDDLE_GAIN = 2.5, 0.48, 0.12
"""What examiners turn the middle depths up by, where blood is, dB; where that is most, and how
widely, shares of the depth."""


class Settings(NamedTuple):
    """Of K patients, or of the B rows of a batch. Lengths in mm, geometry in float64."""

    axes: Tensor  # (K, 3, 3) rows are the organ's axes in the base frame
    origin: Tensor  # (K, 3) mm
    step: Tensor  # (K,) from sample to sample
    half_angle: Tensor  # (K,) rad
    thickness: Tensor  # (K,) of the chest wall
    diaphragm: Tensor  # (K,) distance of the liver from the organ's origin
    waves: Tensor  # (K, 5, WAVES) and
    steps: Tensor  # (K, 5, 3) of `patches`
    loss: Tensor  # (K, 1, 1) float32 from here: dB a sample of soft tissue's attenuation of 1
    along: Tensor  # (K, 1, S) dB: TGC, and what the examiner set it off by, near and far
    hiss: Tensor  # (K, 1, S) power of electronic noise
    ringing: Tensor  # (K, 1, S) power of what bounces under the face
    veil: Tensor  # (K, 1, 1) power of multiple scattering, of the mean echo around
    blood: Tensor  # (K, 1, 1) amplitude of blood's speckle
    contrast: Tensor  # (K, 1, 1) gray 0-1 a decade of power
    lift: Tensor  # (K, 1, 1) gray 0-1 of myocardium
    curve: Tensor  # (K, 1, 1) exponent of the gray map
    grain: Tensor  # (K, 1, 1) gray levels of grain in the finished picture

    def rows(self, rows: Tensor) -> "Settings":
        """Return those of (B,) rows."""
        return Settings(*(each.index_select(0, rows) for each in self))

    def pixel_size(self) -> Tensor:
        """Return (K,) mm, the side of a pixel."""
        return self.step * PROBE.samples * 2.0 * self.half_angle.sin() / IMAGE_SIZE

    def to(self, device: torch.device) -> "Settings":
        """Return them on a device."""
        return Settings(*(each.to(device) for each in self))


def settings_of(patient: Patient, placement: Placement, depth: float, shape: Shape) -> list[Tensor]:
    """Return the fields of one patient, whose sector is `depth` m deep."""
    exam, step = patient.examination, depth / PROBE.samples
    frequency = PROBE.frequency * (PROBE.depth / depth) ** 0.4  # deeper, lower
    fraction = (torch.arange(PROBE.samples, dtype=torch.float64) + 0.5) / PROBE.samples
    tgc = 2.0 * SOFT_LOSS * frequency * 100.0 * depth * fraction
    near = exam.near_gain * torch.exp(-fraction * depth / NEAR_FIELD)
    lift, middle, width = MIDDLE_GAIN
    off = 2.0 * exam.far_gain * (fraction - 0.5)
    off = off + lift * torch.exp(-0.5 * ((fraction - middle) / width).square())
    fading = torch.exp(-fraction * PROBE.depth / RINGING_DEPTH)
    decibel = math.log(10.0) / 10.0

    def scalar(value: float) -> Tensor:
        return torch.tensor(value, dtype=torch.float32).view(1, 1)

    return [
        placement.axes,
        placement.origin * 1e3,
        torch.tensor(step * 1e3, dtype=torch.float64),
        torch.tensor(exam.half_angle, dtype=torch.float64),
        torch.tensor(patient.chest.thickness * 1e3, dtype=torch.float64),
        torch.tensor(shape.diaphragm, dtype=torch.float64),
        *patches_of(patient, shape),
        scalar(frequency * 100.0 * step),
        (tgc + near + off).float().unsqueeze(0),
        torch.exp(decibel * (exam.noise + 0.62 * tgc + off)).float().unsqueeze(0),
        (10.0 ** (exam.reverberation / 10.0) * fading).float().unsqueeze(0),
        scalar(10.0 ** (exam.haze / 10.0)),
        scalar(10.0 ** (patient.tissues.blood / 20.0)),
        scalar(10.0 / exam.dynamic_range),
        scalar(1.0 + exam.gain / exam.dynamic_range),
        scalar(exam.gray_map),
        scalar(exam.grain),
    ]
