"""What keeps a discriminator in check does what its name says."""

import math
from dataclasses import replace
from typing import Any

import pytest
import torch
import yaml
from torch import nn

from racines_data.config import fill
from racines_data.errors import RacinesError
from racines_models.generators.cgan import Cgan, CganConfig
from racines_models.generators.residual_cgan import ResidualCganConfig
from racines_models.generators.stylegan import StyleGanConfig
from racines_models.networks.pyramid import JOININGS, Discriminator
from racines_models.protocol import Run
from racines_models.training.adversary import CHANGES, Adversary, augment, gradient_square
from racines_models.training.objective import Training
from tests.conftest import ROOT
from tests.documents import blocks


def _paper() -> dict[str, Any]:
    """Return the paper's plain setting, as the documentation gives it."""
    page = ROOT / "docs/generators.md"
    (text,) = (block.text for block in blocks(page) if block.language == "yaml")
    return yaml.safe_load(text)


def test_gradient_square_of_a_linear_critic_is_the_square_of_its_weights():
    critic = nn.Linear(6, 1)
    square = gradient_square(lambda x: critic(x.flatten(1)).squeeze(-1), torch.randn(5, 1, 2, 3))
    torch.testing.assert_close(square, critic.weight.square().sum())
    square.backward()
    torch.testing.assert_close(critic.weight.grad, 2 * critic.weight)


def test_penalty_is_lazy_weighed_and_counts_across_a_resume():
    adversary = Adversary(r1=3.0, r1_every=4, normalisation="none")
    critic = Discriminator(2, 15, 4, normalisation="none")
    images, condition, seeds = torch.randn(2, 1, 128, 128), torch.randn(2, 15), torch.arange(2)
    terms = [adversary.penalty(critic, images, condition, seeds) for _ in range(6)]
    assert [term is not None for term in terms] == [True, False, False, False, True, False]
    square = gradient_square(lambda x: critic.judge(x, condition), images)
    assert terms[0] is not None
    torch.testing.assert_close(terms[0], 0.5 * 3.0 * 4 * square)
    resumed = Discriminator(2, 15, 4, normalisation="none")
    resumed.load_state_dict(critic.state_dict())
    due = [adversary.penalty(resumed, images, condition, seeds) is not None for _ in range(3)]
    assert due == [False, False, True]
    assert Adversary(r1=0.0).penalty(critic, images, condition, seeds) is None


def test_penalty_is_in_full_precision_under_mixed_precision():
    adversary, critic = Adversary(r1=1.0, r1_every=1), Discriminator(2, 15, 4, normalisation="none")
    images, condition, seeds = torch.randn(2, 1, 128, 128), torch.randn(2, 15), torch.arange(2)
    plain = adversary.penalty(critic, images, condition, seeds)
    with torch.autocast("cpu", torch.bfloat16):
        mixed = adversary.penalty(critic, images, condition, seeds)
    assert mixed is not None and torch.equal(mixed, plain)


@pytest.mark.parametrize("residual", [False, True])
def test_unnormed_critic_tells_images_apart_from_the_start(residual):
    torch.manual_seed(0)
    critic = Discriminator(12, 15, 8, normalisation="none", residual=residual)
    logits = critic(torch.randn(16, 1, 128, 128), torch.randn(1, 15).expand(16, -1))
    assert 0.2 < float(logits.detach().std()) < 5.0


@pytest.mark.parametrize("joining", JOININGS)
def test_spectral_norm_leaves_no_layer_above_one(joining):
    torch.manual_seed(0)
    critic = Discriminator(2, 15, 4, joining=joining, normalisation="spectral", residual=True)
    for _ in range(60):  # power iterations
        critic(torch.randn(2, 1, 128, 128), torch.randn(2, 15))
    critic.eval()
    layers = [m for m in critic.modules() if isinstance(m, nn.Conv2d | nn.Linear)]
    assert len(layers) > 10
    for layer in layers:
        norm = torch.linalg.matrix_norm(layer.weight.flatten(1), 2)
        assert float(norm.detach()) == pytest.approx(1.0, abs=0.03)


def test_last_joining_only_adds_while_the_others_compare():
    """With `last`, the verdict's change under another condition is the same for every image."""
    torch.manual_seed(0)
    images, conditions = torch.randn(2, 1, 128, 128), torch.randn(2, 15)
    for joining in JOININGS:
        critic = Discriminator(2, 15, 8, joining=joining, normalisation="none")
        change = critic(images, conditions[:1].expand(2, -1)) - critic(
            images, conditions[1:].expand(2, -1)
        )
        assert bool((change[0] - change[1]).abs() < 1e-5) is (joining == "last")


def test_losses_are_those_of_their_names():
    real, drawn = torch.tensor([0.3, 2.0]), torch.tensor([-0.4, 1.5])
    plain, hinge = Adversary(), Adversary(loss="hinge")
    bce = nn.functional.binary_cross_entropy_with_logits
    both = 0.5 * (bce(real, torch.ones(2)) + bce(drawn, torch.zeros(2)))
    torch.testing.assert_close(plain.critic_loss(real, drawn), both)
    torch.testing.assert_close(plain.generator_loss(drawn), bce(drawn, torch.ones(2)))
    wanted = 0.5 * ((0.7 + 0.0) / 2 + (0.6 + 2.5) / 2)
    assert float(hinge.critic_loss(real, drawn)) == pytest.approx(wanted)
    assert float(hinge.generator_loss(drawn)) == pytest.approx(-0.55)


@pytest.mark.parametrize("change", CHANGES)
def test_augmentation_follows_the_seed_and_passes_gradients(change):
    torch.manual_seed(0)
    real, drawn = torch.randn(4, 1, 128, 128), torch.randn(4, 1, 128, 128, requires_grad=True)
    seeds = torch.arange(4)
    changed = augment(real, seeds, [change])
    assert not torch.equal(changed, real)
    assert torch.equal(changed[2:], augment(real[2:], seeds[2:], [change]))
    # The same change of both: what it does is linear in the image, but for brightness.
    offset = augment(torch.zeros(4, 1, 128, 128), seeds, [change])
    both = augment(real + drawn.detach(), seeds, [change]) + offset
    torch.testing.assert_close(both, changed + augment(drawn.detach(), seeds, [change]))
    augment(drawn, seeds, [change]).square().sum().backward()
    assert drawn.grad is not None and bool((drawn.grad.flatten(1).abs().sum(1) > 0).all())


def test_translation_moves_and_cutout_cuts():
    image = torch.zeros(1, 1, 128, 128)
    image[0, 0, 64, 64] = 1.0
    places = set()
    for seed in range(20):
        row, column = augment(image, torch.tensor([seed]), ["translation"])[0, 0].nonzero()[0]
        assert abs(row - 64) <= 16 and abs(column - 64) <= 16
        places.add((int(row), int(column)))
    assert len(places) > 15
    cut = augment(torch.ones(50, 1, 128, 128), torch.arange(50), ["cutout"])
    holes = (cut == 0).flatten(1).sum(1)
    assert int(holes.max()) <= 64**2 and int(holes.min()) >= 31**2


def _file(store, folder, **changes):
    training = Training(images=32, batch_size=16, precision="fp32", ema=0.0)
    config = CganConfig(width=2, discriminator_width=2, latent=4, embedding=4, training=training)
    adversary = replace(config.adversary, **changes)
    Cgan(replace(config, adversary=adversary)).fit(store, Run(folder, progress=False))
    return (folder / "model.safetensors").read_bytes()


def test_each_switch_changes_the_training(store, tmp_path):
    switches: list[dict[str, Any]] = [
        {},
        {"loss": "hinge"},
        {"joining": "last"},
        {"joining": "layers"},
        {"normalisation": "spectral"},
        {"normalisation": "batch"},
        {"r1": 0.0},
        {"augment": ("brightness",)},
    ]
    files = [_file(store, tmp_path / str(i), **each) for i, each in enumerate(switches)]
    assert len(set(files)) == len(switches)


def test_paper_preset_fills_and_has_batch_norm_and_nothing_of_ours():
    for config in (CganConfig, ResidualCganConfig, StyleGanConfig):
        preset = fill(config, _paper())
        assert preset.adversary == Adversary(joining="layers", normalisation="batch", r1=0.0)
        assert preset.training.batch_size == 8 and preset.training.ema == 0.0
        assert preset.latent == 100 and math.isclose(preset.learning_rate, 1e-4)
    nets = Cgan(fill(CganConfig, {**_paper(), "discriminator_width": 2})).networks(15)
    critic = nets["discriminator"]
    assert sum(isinstance(m, nn.BatchNorm2d) for m in critic.modules()) == 5
    assert not any(hasattr(m, "parametrizations") for m in critic.modules())


@pytest.mark.parametrize(
    "change",
    [
        {"loss": "wasserstein"},
        {"joining": "first"},
        {"normalisation": "layer"},
        {"augment": ("flip",)},
        {"r1": -1.0},
        {"r1_every": 0},
    ],
    ids=lambda change: next(iter(change)),
)
def test_unknown_settings_are_refused(change):
    with pytest.raises(RacinesError, match="adversary"):
        Adversary(**change)
