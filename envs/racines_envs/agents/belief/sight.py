"""What a policy is told of an episode: a servo's reading of each image, and what they add up to.

    image ──> servo's network, frozen ──> reading ──> belief where the view lies   ──┐
    pose  ───────────────────────────────────┴──────> best of the poses passed       ├──> 34 numbers
    goal, own steps and idling                                                      ──┘

All places are ways from the probe, in its own axes and in unit steps. Without a memory the belief
is the last reading, and no pose passed is known. Of a window of several looks the numbers of each
are told, the oldest first, with the probe's pose; an episode begins with all of them alike.
"""

import torch
from torch import Tensor
from torch.nn.functional import one_hot

from racines_data.geometry import Pose, matmul3, rotate, rotation_vector
from racines_data.views import VIEWS
from racines_envs.agents.memory.eyes import Eyes
from racines_envs.agents.servo.belief import Belief, reading
from racines_envs.agents.servo.frames import shrink
from racines_envs.agents.steering import Steering
from racines_envs.task.core import PARAMS_SIZE, ScanCore
from racines_models.networks.batching import Lasting

WAY = 6
NEAR, FAR = 2.0, 10.0
"""Unit steps that a way is measured by: to arrive, and to set out."""
SIZE = 3 * WAY + 6 + 3 + 2 + len(VIEWS)
"""Numbers that a policy is told of a look."""
Best = tuple[Pose, Tensor]
"""(N,) poses passed, and how well they showed the view."""


class Sight:
    """A servo's network, and how its readings are told."""

    def __init__(self, eyes: Eyes, memory: bool, window: int = 1, recurrent: bool = False) -> None:
        """Take the network of a training of a servo; without `memory` each image stands alone.

        A policy is told of `window` looks at once; if `recurrent`, it reads one after the other.
        """
        self.network, self.sha256, self.memory = eyes.network.eval(), eyes.sha256, memory
        self.window = window
        self.size = SIZE if window == 1 else window * (SIZE + PARAMS_SIZE)
        self.looks = window if recurrent else 0

    def begin(self, core: ScanCore) -> "Episodes":
        """Return what is known of an environment's episodes: nothing yet."""
        return Episodes(self, core)


class Episodes:
    """What has been seen in the episodes of N rows of one environment."""

    def __init__(self, sight: Sight, core: ScanCore) -> None:
        self._sight, self._core, self._steering = sight, core, Steering(core)
        self._belief: Belief | None = None
        self._best: Best | None = None
        self._told: Tensor | None = None
        self._lasting = Lasting()

    @torch.no_grad()
    def see(self, observation: dict[str, Tensor], rows: Tensor | None = None) -> Tensor:
        """Return the (N, size) numbers after all rows have been looked at.

        Of (N,) bool `rows`, if given, the others were not looked at anew: they are told what they
        were. Rows at the first step of an episode forget the one before.
        """
        pose, state = self._steering.pose(observation), self._core.state
        labels = state.goal
        device = next(self._sight.network.parameters()).device

        def look(part: Tensor) -> Tensor:
            ways, deviations, *shown = self._sight.network.read(
                shrink(part.to(device), self._sight.network.side)
            )
            return torch.cat([ways, deviations, torch.stack(shown, -1)], -1)

        images = observation["image"].view(len(labels), *observation["image"].shape[-2:])
        said = self._lasting(look, images)
        said = said[torch.arange(len(labels), device=device), labels.to(device)].to(labels.device)
        read = reading(pose, said[:, :WAY], said[:, WAY : 2 * WAY])
        shown = said[:, 2 * WAY :] / said.new_tensor([1.0, 10.0])
        worth = shown.sum(1) - 1.0
        belief, best = read, (pose, worth)
        anew = state.steps == 0
        if self._belief is not None and self._best is not None:
            if self._sight.memory:
                belief = self._belief.after(read).kept(~anew, read)
                better = anew | (worth > self._best[1])
                best = _kept(better, best, self._best)
            if rows is not None:
                belief = belief.kept(rows, self._belief)
                best = _kept(rows, best, self._best)
        told = self._tell(pose, belief, best, shown, labels)
        if self._sight.window > 1:
            told = self._after(torch.cat([told, observation["params"].to(told)], 1), anew)
        if rows is not None and self._told is not None:
            told = torch.where(rows.unsqueeze(1), told, self._told)
        self._belief, self._best, self._told = belief, best, told
        return told

    def _after(self, look: Tensor, anew: Tensor) -> Tensor:
        """Return a look behind those before it; at the first of an episode all are that one."""
        alike = look.repeat(1, self._sight.window)
        if self._told is None:
            return alike
        later = torch.cat([self._told[:, look.shape[1] :], look], 1)
        return torch.where(anew.unsqueeze(1), alike, later)

    def _tell(
        self, pose: Pose, belief: Belief, best: Best, shown: Tensor, labels: Tensor
    ) -> Tensor:
        """Return the numbers of beliefs, of the best poses passed and of the last images."""
        task, state = self._core.task, self._core.state
        units = task.step_translation, task.step_rotation
        among = belief.among(labels)
        way, passed = (_way(pose, each, units) for each in (among.pose, best[0]))
        turn = pose.rotation.transpose(1, 2)
        known = [
            matmul3(matmul3(turn, each), pose.rotation).diagonal(dim1=1, dim2=2).clamp_min(1e-6)
            for each in (among.placed, among.turned)
        ]
        passed = passed if self._sight.memory else torch.zeros_like(passed)
        worth = best[1] if self._sight.memory else shown.sum(1) - 1.0
        steps = torch.stack([state.steps / task.max_steps, state.idle.float()], 1)
        told = [(way / NEAR).tanh(), (way / FAR).clamp(-3.0, 3.0), torch.cat(known, 1).log() / 4.0]
        told += [shown, (passed / NEAR).tanh(), worth.unsqueeze(1), steps]
        told += [one_hot(labels, len(VIEWS)).float()]
        return torch.cat(told, 1).float()


def _kept(
    rows: Tensor, own: tuple[Pose, Tensor], other: tuple[Pose, Tensor]
) -> tuple[Pose, Tensor]:
    """Return poses and what they are worth: its own in the (N,) bool rows, others in the rest."""

    def choose(a: Tensor, b: Tensor) -> Tensor:
        return torch.where(rows.view(-1, *[1] * (a.dim() - 1)), a, b)

    pose = Pose(*(choose(a, b) for a, b in zip(own[0], other[0], strict=True)))
    return pose, choose(own[1], other[1])


def _way(pose: Pose, goal: Pose, units: tuple[float, float]) -> Tensor:
    """Return the (N, 6) ways from poses to goals, in the probe's axes and in unit steps."""
    inverse = pose.rotation.transpose(1, 2).contiguous()
    shift = rotate(inverse, goal.position - pose.position) / units[0]
    turn = rotation_vector(matmul3(inverse, goal.rotation)) / units[1]
    return torch.cat([shift, turn], 1)
