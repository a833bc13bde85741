"""Contact of the probe with the gel: how well it couples, and what the wrist sensor feels."""

import math

import torch
from torch import Tensor

from racines_data.geometry import Pose, rotate
from racines_data.phantom.config import ContactConfig, ProbeConfig


def coupling(pose: Pose, surface: float, probe: ProbeConfig) -> Tensor:
    """Return (B, beams) coupling in 0-1: the share of the face that touches, seen by each beam.

    A beam steered to one side draws mostly on the elements of that side, so a probe that lifts at
    one edge loses that side of the sector first.
    """
    device = pose.position.device
    elements = torch.linspace(-0.5, 0.5, 9, device=device) * probe.aperture
    rows = torch.linspace(-0.5, 0.5, 3, device=device) * probe.thickness * 0.8
    depth = (surface - pose.position[:, 2]).view(-1, 1, 1) - (
        pose.rotation[:, 2, 0].view(-1, 1, 1) * elements.view(1, -1, 1)
        + pose.rotation[:, 2, 1].view(-1, 1, 1) * rows.view(1, 1, -1)
    )
    touching = torch.sigmoid((depth + 0.0005) / 0.0007).mean(-1)
    steer = torch.linspace(-1.0, 1.0, probe.beams, device=device).unsqueeze(1)
    weight = torch.exp(-0.5 * ((elements / probe.aperture - 0.22 * steer) / 0.28) ** 2)
    weight = weight / weight.sum(1, keepdim=True)
    return (touching.unsqueeze(1) * weight).sum(-1)


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
