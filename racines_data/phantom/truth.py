"""What is true at a pose, whatever the picture: contact with the gel, and the oracle's judgement.

The oracle says which view a pose shows, how well, and which structures it sees. It knows the
geometry alone, so it cannot be fooled by a generator or a grader.
"""

import math
from functools import lru_cache
from typing import NamedTuple

import torch
from torch import Tensor

from racines_data.geometry import Pose, rotate
from racines_data.phantom.anatomy import Anatomy, ViewSpec
from racines_data.phantom.config import ContactConfig, ProbeConfig
from racines_data.world import Truth

MEMBERSHIP_CENTRE = 0.60
MEMBERSHIP_WIDTH = 0.035
"""A view is attained (membership > 0.5) where completeness passes the centre."""
ROLL_FREE, ROLL_LOST = 0.26, 0.70
"""In-plane rotation from the standard display, rad: free up to the first, lost at the second."""
WINDOW_FREE, WINDOW_LOST = 0.015, 0.035
"""Distance along the surface from the view's acoustic window, m: free, and lost."""


def coupling(pose: Pose, surface: float, probe: ProbeConfig) -> Tensor:
    """Return (B, beams) coupling in 0-1: the share of the face that touches, seen by each beam.

    A beam steered to one side draws mostly on the elements of that side, so a probe that lifts at
    one edge loses that side of the sector first.
    """
    elements, rows, weight = _face(probe, pose.position.device)
    depth = (surface - pose.position[:, 2]).view(-1, 1, 1) - (
        pose.rotation[:, 2, 0].view(-1, 1, 1) * elements.view(1, -1, 1)
        + pose.rotation[:, 2, 1].view(-1, 1, 1) * rows.view(1, 1, -1)
    )
    touching = torch.sigmoid((depth + 0.0005) / 0.0007).mean(-1)
    return (touching.unsqueeze(1) * weight).sum(-1)


@lru_cache(maxsize=64)  # of probes, all of whose rows have the same in every step
def _face(probe: ProbeConfig, device: torch.device) -> tuple[Tensor, Tensor, Tensor]:
    """Return where the face's 9 elements and 3 rows lie, m, and their (beams, 9) weights."""
    elements = torch.linspace(-0.5, 0.5, 9, device=device) * probe.aperture
    rows = torch.linspace(-0.5, 0.5, 3, device=device) * probe.thickness * 0.8
    steer = torch.linspace(-1.0, 1.0, probe.beams, device=device).unsqueeze(1)
    weight = torch.exp(-0.5 * ((elements / probe.aperture - 0.22 * steer) / 0.28) ** 2)
    return elements, rows, weight / weight.sum(1, keepdim=True)


def deepest(force: float, surface: float, config: ContactConfig) -> float:
    """Return the height of the tip, m, at which the gel pushes back with a force, N."""
    a, b = config.hardening, config.stiffness
    return surface - 2.0 * force / (b + math.sqrt(b * b + 4.0 * a * force))


def wrench(pose: Pose, velocity: Tensor | None, surface: float, config: ContactConfig) -> Tensor:
    """Return (B, 6) force and torque at the wrist sensor, in the probe's axes.

    The gel pushes back along the surface's normal, stiffening with depth, never pulling, and drags
    against sliding (Coulomb friction, smooth below `slip_speed`); sensor torque is the lever of
    that force, friction against spinning, and the tool's own weight, which the sensor was zeroed
    for looking straight down.
    """
    depth = (surface - pose.position[:, 2]).clamp_min(0.0)
    normal = config.stiffness * depth + config.hardening * depth.square()
    if velocity is None:
        velocity = pose.position.new_zeros((len(normal), 6))
    slide = velocity[:, :2]
    speed = slide.norm(dim=-1, keepdim=True)
    drag = -slide / (speed + 1e-9) * torch.tanh(speed / config.slip_speed)
    drag = drag * (config.friction * normal).unsqueeze(-1)
    contact = torch.cat([drag, normal.unsqueeze(-1)], -1)
    inverse = pose.rotation.transpose(-1, -2)
    force = rotate(inverse, contact)
    # Weight in the probe's axes, less what it was when the sensor was zeroed (along +z).
    weight = rotate(inverse, contact.new_tensor([0.0, 0.0, -config.tool_weight]).expand_as(contact))
    weight = weight - weight.new_tensor([0.0, 0.0, config.tool_weight])
    lever, arm = config.lever, config.lever - config.tool_centre
    turning = (velocity[:, 3:] * pose.rotation[:, :, 2]).sum(-1)  # about the beam axis, rad/s
    spin = -config.torsion * normal * torch.tanh(turning / config.spin_speed)
    across = lever * force[:, 0] + arm * weight[:, 0]
    torque = torch.stack([-lever * force[:, 1] - arm * weight[:, 1], across, spin], -1)
    return torch.cat([force + weight, torque], -1) + force.new_tensor(config.offset)


class Oracle(NamedTuple):
    """Landmarks and views of an anatomy in the base frame."""

    centres: Tensor  # (S, 3) m
    radii: Tensor  # (S,) m
    weights: Tensor  # (V, S), rows sum to one
    targets: Pose  # (V,) nominal poses

    def judge(self, pose: Pose, probe: ProbeConfig, coupling: Tensor) -> Truth:
        """Judge (B,) poses whose (B, beams) coupling is known."""
        seen = self._visibility(pose, probe, coupling)
        # A weighted geometric mean: one lost structure spoils a view, as it does for an expert.
        complete = (self.weights * seen.clamp_min(0.02).log().unsqueeze(1)).sum(-1).exp()
        score = complete * self._display(pose) * self._window(pose)
        clarity = coupling.mean(-1)
        membership = torch.sigmoid((score - MEMBERSHIP_CENTRE) / MEMBERSHIP_WIDTH)
        membership = membership * torch.sigmoid((clarity - 0.35) / 0.04).unsqueeze(-1)
        best, view = membership.max(-1)
        attained = best > 0.5
        progress = ((score - 0.5) / 0.45).clamp(0.0, 1.0)
        view_grade = (10.0 * progress * clarity.clamp(0.0, 1.0).unsqueeze(-1)).clamp(0.0, 10.0)
        grade = view_grade.gather(-1, view.unsqueeze(-1)).squeeze(-1).clamp_min(1.0)
        return Truth(
            view=torch.where(attained, view, membership.shape[-1]),  # Random
            grade=torch.where(attained, grade, 0.0),
            membership=membership,
            view_grade=view_grade,
            clarity=clarity,
            visibility=seen,
        )

    def _visibility(self, pose: Pose, probe: ProbeConfig, coupling: Tensor) -> Tensor:
        offset = self.centres - pose.position.unsqueeze(1)
        inverse = pose.rotation.transpose(-1, -2).unsqueeze(1)
        lateral, elevation, axial = rotate(inverse, offset).unbind(-1)
        in_plane = torch.exp(-0.5 * (elevation / (0.6 * self.radii)).square())
        radius = (lateral.square() + axial.square()).sqrt()
        angle = torch.atan2(lateral, axial)
        in_sector = torch.sigmoid((probe.half_angle - angle.abs()) * radius / 0.002)
        in_depth = torch.sigmoid((probe.depth - radius) / 0.002)
        beams = coupling.shape[-1]
        beam = ((angle / probe.half_angle + 1.0) * 0.5 * (beams - 1)).round().long()
        coupled = coupling.gather(-1, beam.clamp(0, beams - 1))
        return in_plane * in_sector * in_depth * coupled.sqrt()

    def _display(self, pose: Pose) -> Tensor:
        """Return (B, V) in 0-1: how near the picture is turned to the standard display."""
        beam = pose.rotation[:, None, :, 2]
        lateral = self.targets.rotation[None, :, :, 0]
        axial = self.targets.rotation[None, :, :, 2]
        roll = torch.atan2((beam * lateral).sum(-1), (beam * axial).sum(-1)).abs()
        upright = ((ROLL_LOST - roll) / (ROLL_LOST - ROLL_FREE)).clamp(0.0, 1.0)
        facing = (pose.rotation[:, None, :, 1] * self.targets.rotation[None, :, :, 1]).sum(-1)
        return upright * (3.0 - 2.0 * upright) * upright * (facing > 0.0)

    def _window(self, pose: Pose) -> Tensor:
        """Return (B, V) in 0-1: how near the probe stands to the view's acoustic window.

        Planes meet along lines, so a plane alone can be had from far off; a view is named for its
        window too: the same four chambers are apical from one place and subcostal from another.
        """
        offset = pose.position[:, None, :2] - self.targets.position[None, :, :2]
        away = offset.square().sum(-1).sqrt()
        near = ((WINDOW_LOST - away) / (WINDOW_LOST - WINDOW_FREE)).clamp(0.0, 1.0)
        return (3.0 - 2.0 * near) * near * near


def make_oracle(anatomy: Anatomy, surface: float, device: torch.device) -> Oracle:
    """Place an anatomy's landmarks and views in the base frame."""
    axes = torch.tensor(anatomy.axes, device=device)
    origin = torch.tensor(anatomy.origin, device=device)
    centres = torch.tensor([s.centre for s in anatomy.structures], device=device) @ axes + origin
    radii = torch.tensor([s.radius for s in anatomy.structures], device=device)
    names = [s.name for s in anatomy.structures]
    weights = torch.zeros((len(anatomy.views), len(names)), device=device)
    for row, view in enumerate(anatomy.views):
        for name, weight in view.structures:
            weights[row, names.index(name)] = weight
    poses = [nominal_pose(view, axes, origin, surface) for view in anatomy.views]
    targets = Pose(*(torch.stack(parts) for parts in zip(*poses, strict=True)))
    return Oracle(centres, radii, weights / weights.sum(1, keepdim=True), targets)


def nominal_pose(view: ViewSpec, axes: Tensor, origin: Tensor, surface: float) -> Pose:
    """Go from a view's focus back along its beam to just under the surface."""
    normal = torch.nn.functional.normalize(axes.new_tensor(view.normal) @ axes, dim=0)
    beam = axes.new_tensor(view.beam) @ axes
    beam = torch.nn.functional.normalize(beam - (beam @ normal) * normal, dim=0)
    focus = axes.new_tensor(view.focus) @ axes + origin
    distance = (surface - view.indentation - focus[2]) / -beam[2]
    position = focus - distance * beam
    return Pose(position, torch.stack([torch.linalg.cross(normal, beam), normal, beam], -1))
