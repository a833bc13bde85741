"""Disturbances: what may be wrong in a scan, each at three strengths, beyond what training shows.

Some change the patient or the scanner's settings before anything is drawn, and so also what is
true (a rib that swallows more sound hides what lies behind it). The others come between the world
and the agent: a picture that loses light, a pose that is misread, a step that is not the one that
was asked for. Each is drawn by the episode's seed, whatever other rows do.
"""

import dataclasses
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from racines_data.geometry import Pose, axis_angle_to_matrix, matmul3
from racines_data.patients.patient import Patient
from racines_data.randomness import derive, normal, uniform
from racines_envs.task.actions import ACTIONS, IDLE
from racines_envs.task.names import BEATING, PATIENTS

STREAM = 443
"""First of the random streams of the disturbances; each has ten."""
STRENGTHS = ("mild", "moderate", "strong")
APEX = -0.02
"""Height of the sector's apex above the image, as a share of it."""
DARK = 0.06
"""Share of its light that is left to a beam without contact: 24 dB less."""
SLIPS = 0.02
"""Share of the moves with which the probe slips."""


@dataclass(frozen=True)
class Disturbance:
    """One thing that may be wrong; those of its functions that are None leave all as it is."""

    name: str
    what: str
    """For people: what happens."""
    unit: str
    amounts: tuple[float, float, float]
    """Mild, moderate, strong."""
    patient: Callable[[Patient, float], Patient] | None = None
    """(patient, amount) -> patient, examined otherwise."""
    image: Callable[[Tensor, Tensor, float], Tensor] | None = None
    """((N, 128, 128) uint8, (N,) episode seeds, amount) -> images of that kind."""
    told: Callable[[Pose, Tensor, float], Pose] | None = None
    """((N,) poses, (N,) episode seeds, amount) -> poses that the arm reports."""
    action: Callable[[Tensor, Tensor, float], Tensor] | None = None
    """((N,) actions, (N,) seeds of this step, amount) -> actions that are carried out."""
    slip: Callable[[Pose, Tensor, Tensor, float], Pose] | None = None
    """((N,) poses, (N,) actions, (N,) seeds of this step, amount) -> poses before the step."""
    tiers: tuple[str, ...] = (PATIENTS, BEATING)
    """Tiers in which it means anything."""


def _examined(**changes: float) -> Callable[[Patient, float], Patient]:
    """Return what adds so many amounts to settings of the examination."""

    def change(patient: Patient, amount: float) -> Patient:
        before = patient.examination
        after = {key: getattr(before, key) + times * amount for key, times in changes.items()}
        return dataclasses.replace(patient, examination=dataclasses.replace(before, **after))

    return change


def _either_way(patient: Patient) -> float:
    """Return 1 or -1 by the patient: what goes one way in some goes the other way in others."""
    return 1.0 if int(derive(torch.tensor([patient.seed]), STREAM)[0]) % 2 else -1.0


def _gain(patient: Patient, amount: float) -> Patient:
    return _examined(gain=_either_way(patient))(patient, amount)


def _gray_map(patient: Patient, amount: float) -> Patient:
    examination = patient.examination
    curve = examination.gray_map * amount ** _either_way(patient)
    return dataclasses.replace(
        patient, examination=dataclasses.replace(examination, gray_map=curve)
    )


def _in_chest(name: str) -> Callable[[Patient, float], Patient]:
    def change(patient: Patient, amount: float) -> Patient:
        told = {name: getattr(patient.chest, name) + amount}
        return dataclasses.replace(patient, chest=dataclasses.replace(patient.chest, **told))

    return change


def _moving(patient: Patient, amount: float) -> Patient:
    before = patient.motion
    told = {"sway": before.sway * amount, "variation": before.variation + 0.05 * (amount - 1.0)}
    return dataclasses.replace(patient, motion=dataclasses.replace(before, **told))


def _uncoupled(images: Tensor, seeds: Tensor, amount: float) -> Tensor:
    """Darken a band of beams, a share of the sector, which lies elsewhere in each episode."""
    size = images.shape[-1]
    down, across = torch.meshgrid(
        (torch.arange(size, device=images.device) + 0.5) / size - APEX,
        (torch.arange(size, device=images.device) + 0.5) / size - 0.5,
        indexing="ij",
    )
    beam = 0.5 + torch.atan2(across, down) / math.radians(76.0)
    middle = uniform(seeds, 1, STREAM + 10)[:, 0].view(-1, 1, 1)
    lost = torch.sigmoid((amount / 2.0 - (beam - middle).abs()) / 0.01)
    return (images * (1.0 - (1.0 - DARK) * lost)).round().to(torch.uint8)


def _misread(pose: Pose, seeds: Tensor, amount: float) -> Pose:
    """Shift poses by so many millimetres one way, and turn them by half as many degrees."""
    drawn = torch.nn.functional.normalize(normal(seeds, 6, STREAM + 20).view(-1, 2, 3), dim=-1)
    turn = axis_angle_to_matrix(drawn[:, 1] * math.radians(amount / 2.0))
    return Pose(pose.position + drawn[:, 0] * amount * 1e-3, matmul3(turn, pose.rotation))


def _astray(action: Tensor, seeds: Tensor, amount: float) -> Tensor:
    """Carry out some other step in place of a share of the moves; who rests is let rest."""
    drawn = uniform(seeds, 2, STREAM + 30)
    other = (drawn[:, 1] * (len(ACTIONS) - 1)).long()
    return torch.where((drawn[:, 0] < amount) & (action != IDLE), other, action)


def _slipped(pose: Pose, action: Tensor, seeds: Tensor, amount: float) -> Pose:
    """Let the probe slip over the skin by so many millimetres, with a few of the moves."""
    drawn = uniform(seeds, 2, STREAM + 40)
    way = 2.0 * math.pi * drawn[:, 1]
    shift = torch.stack([way.cos(), way.sin(), torch.zeros_like(way)], -1) * amount * 1e-3
    slips = (drawn[:, :1] < SLIPS) & (action != IDLE).unsqueeze(1)
    return Pose(torch.where(slips, pose.position + shift, pose.position), pose.rotation)


_EVERY = (
    Disturbance("haze", "clutter over the picture, densest near the probe", "dB",
                (4.0, 8.0, 12.0), patient=_examined(haze=1.0)),
    Disturbance("cover", "uneven fat and muscle before the heart dim and brighten beams", "dB",
                (2.0, 4.0, 6.0), patient=_in_chest("cover")),
    Disturbance("ribs", "ribs that swallow more sound", "dB",
                (4.0, 8.0, 12.0), patient=_in_chest("rib_loss")),
    Disturbance("gain", "too bright in half of the patients, too dark in the others", "dB",
                (5.0, 10.0, 15.0), patient=_gain),
    Disturbance("gray map", "another curve of gray levels, steeper or flatter", "times",
                (1.25, 1.5, 2.0), patient=_gray_map),
    Disturbance("noise", "electronic noise", "dB", (6.0, 12.0, 18.0),
                patient=_examined(noise=1.0)),
    Disturbance("reverberation", "echoes between probe and skin", "dB", (5.0, 10.0, 15.0),
                patient=_examined(reverberation=1.0)),
    Disturbance("coupling loss", "a band of beams has no contact, elsewhere in each episode",
                "of the sector", (0.1, 0.2, 0.35), image=_uncoupled),
    Disturbance("pose bias", "the arm misreads where it is, one way all along, and by half as many "
                "degrees", "mm", (2.0, 5.0, 10.0), told=_misread),
    Disturbance("action noise", "another step is done than was asked for", "of the moves",
                (0.05, 0.1, 0.2), action=_astray),
    Disturbance("slip", f"the probe slips over the skin, with {SLIPS:.0%} of the moves", "mm",
                (3.0, 6.0, 12.0), slip=_slipped),
    Disturbance("motion", "deeper breaths and a less regular heart; beating hearts alone", "times",
                (1.5, 2.0, 3.0), patient=_moving, tiers=(BEATING,)),
)  # fmt: skip
DISTURBANCES: Mapping[str, Disturbance] = {each.name: each for each in _EVERY}
"""By name, in the order of reports."""
Applied = Mapping[Disturbance, float]
"""Disturbances at work, and how strong each is."""


def disturbed(patient: Patient, applied: Applied) -> Patient:
    """Return a patient as the disturbances leave it."""
    for each, amount in applied.items():
        patient = patient if each.patient is None else each.patient(patient, amount)
    return patient


def told(applied: Applied) -> dict[str, Any]:
    """Return disturbances as documents name them."""
    return {each.name: amount for each, amount in applied.items()}
