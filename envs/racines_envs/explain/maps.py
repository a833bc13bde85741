"""What in an image moved a decision: Integrated Gradients from a black image.

Sundararajan et al., Axiomatic Attribution for Deep Networks, 2017; Captum's implementation.
"""

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from racines_data.errors import RacinesError
from racines_models.judges.grader.model import Grader
from racines_models.protocol import Judge

Explained = Callable[[Tensor, Tensor], Tensor]
"""(B, 128, 128) float images, gray levels 0-255, and (B, 9) parameters -> (B, outputs)."""

BATCH = 256
"""Images at once in a backward pass."""


def policy_logits(agent: Any) -> Explained:
    """Return an agent's scores of the 13 actions as a function of its image, if it has such."""
    name, observation = getattr(agent, "name", type(agent).__name__), agent.observation
    if observation == "params":
        raise RacinesError(
            f"agent {name!r} looks at no image (observation 'params'), and an explanation is of "
            "images: train one with --observation image or multimodal"
        )
    if not hasattr(agent, "logits"):
        raise RacinesError(
            f"agent {name!r} has no logits(observation) to differentiate: only learned policies "
            "(such as ppo) can be explained"
        )
    for network in (getattr(agent, "actor", None), getattr(agent, "encoder", None)):
        if network is not None:
            network.eval().requires_grad_(False)

    def judge(images: Tensor, params: Tensor) -> Tensor:
        pose = {"params": params} if observation == "multimodal" else {}
        return agent.logits({"image": images} | pose)

    return judge


def grader_probabilities(grader: Judge) -> Explained:
    """Return a grader's probabilities of the views as a function of the image, if it is ours."""
    if not isinstance(grader, Grader):
        raise RacinesError(f"grader {grader!r} has no network to differentiate: give a run folder")
    network = grader.network

    def judge(images: Tensor, params: Tensor) -> Tensor:
        logits, _ = network(network.normalise(images.to(grader.device)))
        return (logits / grader.temperature).softmax(-1)

    return judge


def integrated_gradients(
    judge: Explained, images: Tensor, params: Tensor, targets: Tensor, steps: int = 50
) -> tuple[Tensor, Tensor]:
    """Attribute one output an image to its pixels, from a black image.

    `images` are (N, 128, 128) uint8, `params` (N, 9) and held fixed, `targets` (N,) int64, which
    output of each, `steps` the points of the integral (Gauss-Legendre).

    Returns:
        (N, 128, 128) float32 attributions, and the (N,) completeness error: their sum less the
        difference of the outputs between image and black image, which would be 0 with an exact
        integral.
    """
    from captum.attr import IntegratedGradients

    method, found = IntegratedGradients(judge), []
    parts = zip(images.split(BATCH), params.split(BATCH), targets.split(BATCH), strict=True)
    for part, given, wanted in parts:
        black = torch.zeros_like(part, dtype=torch.float32)
        attributed = method.attribute(
            part.float(), baselines=black, target=wanted, additional_forward_args=(given,),
            n_steps=steps, internal_batch_size=BATCH, return_convergence_delta=True,
        )  # fmt: skip
        found.append(attributed)
    maps, errors = (torch.cat(column).detach().float() for column in zip(*found, strict=True))
    return maps, errors


@torch.no_grad()
def outputs(judge: Explained, images: Tensor, params: Tensor) -> Tensor:
    """Return (N, outputs) of (N, 128, 128) images of any type."""
    parts = zip(images.split(BATCH), params.split(BATCH), strict=True)
    return torch.cat([judge(part.float(), given) for part, given in parts])
