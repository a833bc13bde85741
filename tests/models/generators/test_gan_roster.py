"""The paper's four plain GANs: the contract, and what sets each apart."""

import pytest
import torch

from racines_data.errors import RacinesError
from racines_models.generators.attention_cgan import AttentionCgan, AttentionCganConfig
from racines_models.generators.cgan import Cgan, CganConfig, GanConfig
from racines_models.generators.residual_cgan import ResidualCgan, ResidualCganConfig
from racines_models.generators.stylegan import StyleGan, StyleGanConfig
from racines_models.generators.vae_gan import VaeGan, VaeGanConfig
from racines_models.networks.layers import SelfAttention
from racines_models.networks.pyramid import Pyramid, ResidualUp
from racines_models.networks.style import ModulatedConv, StyleSynthesis
from racines_models.protocol import Run
from racines_models.testing import GeneratorContract
from racines_models.training.adversary import Adversary
from racines_models.training.objective import Training
from tests.models.training.test_trainer_resume import fit, kill, weights

TRAINING = Training(images=32, batch_size=16, precision="fp32", ema=0.9)
SIZES = {"width": 2, "discriminator_width": 2, "latent": 6, "embedding": 6}
TINY = {
    **SIZES,
    "learning_rate": 0.03,
    "training": TRAINING,
    "adversary": Adversary(normalisation="spectral", r1=1.0, r1_every=2),
}
CONFIGS = {
    Cgan: CganConfig,
    AttentionCgan: AttentionCganConfig,
    ResidualCgan: ResidualCganConfig,
    StyleGan: StyleGanConfig,
}


class TestCgan(GeneratorContract):
    generator_class = Cgan
    config = CganConfig(**TINY)


class TestAttentionCgan(GeneratorContract):
    generator_class = AttentionCgan
    config = AttentionCganConfig(**TINY)


class TestResidualCgan(GeneratorContract):
    generator_class = ResidualCgan
    config = ResidualCganConfig(**TINY | {"width": 4})


class TestStyleGan(GeneratorContract):
    generator_class = StyleGan
    config = StyleGanConfig(**TINY, style=6, mapping_layers=2)


def _networks(cls, **changes):
    generator = cls(CONFIGS[cls](**(TINY | changes)))
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        return generator.networks(15)


def test_killed_and_resumed_with_spectral_norm_and_a_penalty_now_and_then(tmp_path):
    """Power iterations and the count of lazy penalties come back from the checkpoint."""
    training = Training(images=160, batch_size=8, precision="fp32", checkpoint_every=40)
    adversary = Adversary(normalisation="spectral", r1=10.0, r1_every=3, augment=("translation",))
    config = CganConfig(**(TINY | {"training": training, "adversary": adversary}))
    fit(tmp_path / "whole", Cgan, config)
    kill(tmp_path / "killed", make=Cgan, config=config)
    fit(tmp_path / "killed", Cgan, config, resume=True)
    assert weights(tmp_path / "killed") == weights(tmp_path / "whole")


def test_each_row_has_the_layers_of_its_name():
    def count(cls, kind):
        return [sum(isinstance(m, kind) for m in net.modules()) for net in _networks(cls).values()]

    assert count(Cgan, SelfAttention) == [0, 0] and count(AttentionCgan, SelfAttention) == [1, 1]
    assert count(Cgan, ResidualUp) == [0, 0] and count(ResidualCgan, ResidualUp) == [4, 0]
    assert count(Cgan, ModulatedConv)[0] == 0 and count(StyleGan, ModulatedConv)[0] == 9 + 4


def test_same_seed_same_start_other_seed_another(store, tmp_path):
    files = set()
    for seed in (1, 2):
        generator = Cgan(CganConfig(**TINY))
        generator.fit(store, Run(tmp_path / str(seed), seed=seed, progress=False))
        files.add((tmp_path / str(seed) / "model.safetensors").read_bytes())
    assert len(files) == 2


def _normal(*shape):
    return torch.randn(*shape, generator=torch.Generator().manual_seed(1))


@pytest.mark.parametrize("cls", [Cgan, AttentionCgan, ResidualCgan], ids=lambda cls: cls.name)
def test_norm_injects_the_condition_in_every_layer_and_concat_at_the_input_only(cls):
    """With the dense layer's condition columns cleared, only `norm` still follows the pose."""
    noise, condition = _normal(2, 6), _normal(2, 15)
    for injection, follows in (("norm", True), ("concat", False)):
        net = _networks(cls, injection=injection, width=8)["generator"].eval()
        assert (net(noise, condition) != net(noise, condition.flip(0))).any()
        with torch.no_grad():
            net.dense.weight[:, 6:] = 0
        assert bool((net(noise, condition) != net(noise, condition.flip(0))).any()) is follows
        if follows:
            assert all(
                module.affine is not None
                for block in net.blocks
                for module in block.modules()
                if hasattr(module, "affine") and hasattr(module, "norm")
            )


def test_vae_gan_takes_the_injection_too(store, tmp_path):
    files = set()
    for injection in ("concat", "norm"):
        config = VaeGanConfig(**SIZES, encoder_width=2, injection=injection, training=TRAINING)
        VaeGan(config).fit(store, Run(tmp_path / injection, progress=False))
        assert VaeGan.load(tmp_path / injection).config.injection == injection
        files.add((tmp_path / injection / "model.safetensors").stat().st_size)
    assert len(files) == 2


def test_modulated_convolution_equals_one_with_each_samples_own_weights():
    """StyleGAN2, equations 1 and 3, written out."""
    torch.manual_seed(0)
    conv = ModulatedConv(3, 5, 4)
    maps, style = _normal(2, 3, 8, 8), _normal(2, 4)
    got = conv(maps, style)
    for i in range(2):
        weight = conv.weight * conv.scale * conv.style(style)[i][None, :, None, None]
        weight = weight / (weight.square().sum((1, 2, 3), keepdim=True) + 1e-8).sqrt()
        wanted = torch.nn.functional.conv2d(maps[i : i + 1], weight, padding=1)[0]
        torch.testing.assert_close(got[i], wanted, atol=1e-5, rtol=1e-4)


def test_style_noise_reaches_the_image_layer_by_layer():
    """Each styled layer's own noise changes the image once its strength is not 0."""
    torch.manual_seed(0)
    net = StyleSynthesis(2, 6, 15, style=6, layers=1, rate=0.01)
    noise, condition = _normal(1, net.noise), _normal(1, 15)
    first = net(noise, condition)
    other = torch.cat([noise[:, :6], _normal(1, net.noise - 6)], 1)
    assert torch.equal(first, net(other, condition))
    starts = [sum(net.sizes[: place + 1]) for place in range(len(net.layers))]
    for layer, start, size in zip(net.layers, starts, net.sizes[1:], strict=True):
        with torch.no_grad():
            layer.strength.fill_(1.0)
        changed = noise.clone()
        changed[:, start : start + size] += 1.0
        assert not torch.equal(net(noise, condition), net(changed, condition))
        with torch.no_grad():
            layer.strength.zero_()


def test_style_starts_without_a_checkerboard():
    """The four interleaved maps of the last layer are alike until training parts them."""
    torch.manual_seed(0)
    net = StyleSynthesis(2, 6, 15, style=6, layers=1, rate=0.01)
    image = net(_normal(1, net.noise), _normal(1, 15))[0, 0]
    assert torch.equal(image[::2, ::2], image[1::2, 1::2])
    assert float(image[::2, ::2].std().detach()) > 0


def test_attention_starts_as_the_identity_and_then_looks_afar():
    torch.manual_seed(0)
    layer, maps = SelfAttention(8), _normal(1, 8, 32, 32)
    assert torch.equal(layer(maps), maps)
    with torch.no_grad():
        layer.gain.fill_(1.0)
    far = maps.clone()
    far[:, :, 31, 31] += 10.0
    assert ((layer(far) - layer(maps))[0, :, 0, 0].abs() > 0).any()


@pytest.mark.thorough
def test_reconstruction_weight_pulls_towards_the_frame(store, tmp_path):
    """Switched on, drawn images come nearer to the frames; off by default, as in the paper."""
    assert CganConfig().reconstruction_weight == 0.0
    errors = []
    for weight in (0.0, 100.0):
        training = Training(images=320, batch_size=16, precision="fp32", ema=0.0)
        config = CganConfig(**(TINY | {"reconstruction_weight": weight, "training": training}))
        metrics = Cgan(config).fit(store, Run(tmp_path / str(weight), progress=False))
        errors.append(metrics["validation"]["mae"])
    assert errors[1] < errors[0]


@pytest.mark.parametrize(
    ("config", "change"),
    [
        (CganConfig, {"width": 0}),
        (CganConfig, {"injection": "everywhere"}),
        (ResidualCganConfig, {"learning_rate": 0.0}),
        (AttentionCganConfig, {"reconstruction_weight": -1.0}),
        (StyleGanConfig, {"mapping_layers": 0}),
        (VaeGanConfig, {"injection": "film"}),
    ],
)
def test_impossible_settings_are_refused_by_name(config, change):
    name = getattr(config, "name", "vae-gan")
    with pytest.raises(RacinesError, match=name):
        config(**change)


def test_pyramid_and_style_say_how_much_noise_they_take():
    assert Pyramid(2, 7, 15).noise == 7
    places = 16 + 2 * (8**2 + 16**2 + 32**2 + 64**2)
    assert StyleSynthesis(2, 7, 15, style=4, layers=1, rate=1.0).noise == 7 + places
    assert GanConfig().latent == 100  # the paper's


@pytest.mark.parametrize("sector", [True, False])
@pytest.mark.parametrize("cls", [VaeGan, Cgan])
def test_what_is_always_black_stays_black_unless_switched_off(store, tmp_path, cls, sector):
    few = Training(images=32, batch_size=16, precision="fp32", ema=0.0)
    cls(cls.Config(width=2, latent=6, sector=sector, training=few)).fit(
        store, Run(tmp_path, progress=False)
    )
    black = store.images[store.split_indices("train")].amax(0) == 0
    images = cls.load(tmp_path).generate(store.parameters[:8], 0)
    assert black.any() and images[:, ~black].any()
    assert bool((images[:, black] == 0).all()) is sector
