"""Generators as ONNX files: what is exported, what it draws, and which files are refused."""

import json

import numpy as np
import pytest
import torch
from onnx import TensorProto, helper, numpy_helper

from racines_data.errors import RacinesError
from racines_data.imaging import ImageSource
from racines_data.randomness import derive, normal, sample_seeds
from racines_models.exchange.onnx.file import open_session
from racines_models.exchange.onnx.generator import OnnxGenerator, export_generator
from racines_models.generators.mean_image import MeanImage
from racines_models.generators.nearest_pose import NearestPose
from racines_models.generators.vae_gan import VaeGan, VaeGanConfig
from racines_models.networks.painting import OnnxModule
from racines_models.protocol import Run
from racines_models.registry import open_generator
from racines_models.training.objective import Training
from tests.conftest import command

TINY = Training(images=320, batch_size=16, ema=0.0, sample_every=320, checkpoint_every=320)


@pytest.fixture(scope="module")
def store():
    from tests.models.conftest import FakeStore

    return FakeStore()


@pytest.fixture(scope="module")
def vae_gan(store, tmp_path_factory):
    folder = tmp_path_factory.mktemp("vae-gan")
    config = VaeGanConfig(
        width=4, encoder_width=2, discriminator_width=2, learning_rate=0.01, training=TINY
    )
    VaeGan(config).fit(store, Run(folder, 3, "cpu", progress=False))
    generator = VaeGan.load(folder)
    made = export_generator(generator, folder / "vae-gan.onnx")
    assert made["noise"] == 100 and made["bytes"] == (folder / "vae-gan.onnx").stat().st_size
    return generator, folder / "vae-gan.onnx"


@pytest.fixture(scope="module")
def poses(store):
    parameters = store.parameters[:50].clone()
    parameters[3:9, :6] = float("nan")
    return parameters


def test_draws_what_the_class_draws(vae_gan, poses):
    """Within one gray level in a few pixels of 0.8 million: arithmetic in another order."""
    generator, path = vae_gan
    opened = open_generator(str(path))
    assert isinstance(opened, OnnxGenerator) and isinstance(opened, ImageSource)
    apart = (opened.generate(poses, 5).int() - generator.generate(poses, 5).int()).abs()
    assert apart.max() <= 1 and int((apart > 0).sum()) <= 100
    assert not torch.equal(opened.generate(poses, 5), opened.generate(poses, 6))


@pytest.mark.contract
def test_a_sample_ignores_its_batch(vae_gan, poses):
    opened = OnnxGenerator(vae_gan[1])
    seeds = torch.arange(len(poses)) * 7 + 1
    together = opened.generate(poses, seeds)
    alone = [opened.generate(poses[i : i + 1], seeds[i : i + 1]) for i in range(0, 50, 7)]
    assert torch.equal(together[::7], torch.cat(alone))
    assert torch.equal(together.flip(0), opened.generate(poses.flip(0), seeds.flip(0)))
    assert opened.generate(poses[:0], 0).shape == (0, 128, 128)


def test_the_file_runs_without_our_code(vae_gan, poses):
    """Bare onnxruntime with noise made as documented."""
    import onnxruntime

    generator, path = vae_gan
    session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    told = session.get_modelmeta().custom_metadata_map
    noise = json.loads(told["racines.noise"])
    seeds = sample_seeds(5, 3)
    inputs = {"parameters": poses[:3], "noise": normal(derive(seeds, *noise["keys"]), 100)}
    (images,) = session.run(["images"], {key: value.numpy() for key, value in inputs.items()})
    apart = np.abs(images.astype(int) - generator.generate(poses[:3], 5).numpy())
    assert images.dtype == np.uint8 and apart.max() <= 1


def test_metadata_are_those_of_the_generator(vae_gan):
    generator, path = vae_gan
    interface = OnnxGenerator(path).interface
    assert interface.name == "vae-gan" and interface.noise is not None
    assert interface.card["data"] == generator.data and interface.card["seed"] == 3
    assert "digest-0-240" in json.dumps(interface.card)


def test_export_repeats_and_tells_nothing_of_the_machine(vae_gan, tmp_path):
    generator, path = vae_gan
    export_generator(generator, tmp_path / "again.onnx")
    content = (tmp_path / "again.onnx").read_bytes()
    assert content == path.read_bytes()
    assert b".py" not in content and b"stack_trace" not in content
    assert generator.nets is not None  # the exported copy is another
    assert [path.name for path in tmp_path.iterdir()] == ["again.onnx"]


def test_mean_image_has_no_noise_and_draws_the_same(store, poses, tmp_path):
    generator = MeanImage()
    generator.fit(store, Run(tmp_path, 0, "cpu", progress=False))
    assert export_generator(generator, tmp_path / "m.onnx")["noise"] == 0
    opened = OnnxGenerator(tmp_path / "m.onnx")
    assert opened.interface.noise is None and opened.interface.card["stochastic"] is False
    assert torch.equal(opened.generate(poses, 0), generator.generate(poses, 0))


def test_what_is_no_network_cannot_be_exported(store, tmp_path):
    retrieval = NearestPose()
    retrieval.fit(store, Run(tmp_path, 0, "cpu", progress=False))
    with pytest.raises(RacinesError, match="nearest-pose cannot be an ONNX file.*predictions"):
        export_generator(retrieval, tmp_path / "n.onnx")
    with pytest.raises(RacinesError, match="mean-image is not fitted"):
        export_generator(MeanImage(), tmp_path / "n.onnx")

    class Other:
        name = "other"

    with pytest.raises(RacinesError, match="other has no onnx_module"):
        export_generator(Other(), tmp_path / "n.onnx")


def test_a_network_that_cannot_run_leaves_no_file(vae_gan, tmp_path):
    class Sorted(torch.nn.Module):
        def forward(self, parameters):
            return torch.linalg.eigvalsh(parameters @ parameters.T)[:, None, None]

    class Spoiled(VaeGan):
        def onnx_module(self):
            return OnnxModule(Sorted())

    spoiled = Spoiled(vae_gan[0].config)
    spoiled.nets = vae_gan[0].nets
    with pytest.raises(RacinesError, match="Sorted cannot be traced to ONNX"):
        export_generator(spoiled, tmp_path / "s.onnx")
    with pytest.raises(RacinesError, match="exported.*onnxruntime cannot load it"):
        open_session(b"nothing", "s.onnx, exported", "cpu")
    assert not list(tmp_path.iterdir())


def test_bad_poses_are_refused(vae_gan, poses):
    broken = poses.clone()
    broken[2, 7] = float("nan")
    with pytest.raises(RacinesError, match="position_y of row 2"):
        OnnxGenerator(vae_gan[1]).generate(broken, 0)


def test_missing_packages_name_the_extra(tmp_path):
    code = """
import sys
sys.modules["onnxruntime"] = None
from racines_models.registry import open_generator
open_generator("x.onnx")
"""
    done = command(tmp_path, "python", "-c", code, code=1)
    assert 'pip install "racines[onnx]"' in done.stderr


class Graph:
    """A hand-made model that paints a constant, to be spoiled one part at a time."""

    def __init__(self, value=40, kind=TensorProto.UINT8, shape=("B", 128, 128)):
        self.parameters = helper.make_tensor_value_info("parameters", TensorProto.FLOAT, ["B", 12])
        self.output = helper.make_tensor_value_info("images", kind, list(shape))
        dtype = helper.tensor_dtype_to_np_dtype(kind)
        constant = numpy_helper.from_array(np.full((1, *shape[1:]), value, dtype), "constant")
        size = numpy_helper.from_array(np.array([1] * (len(shape) - 1)), "ones")
        self.initializers = [constant, size]
        self.nodes = [
            helper.make_node("Shape", ["parameters"], ["count"], start=0, end=1),
            helper.make_node("Concat", ["count", "ones"], ["size"], axis=0),
            helper.make_node("Expand", ["constant", "size"], ["images"]),
        ]
        self.inputs, self.opset, self.metadata = [self.parameters], 18, {}

    def model(self):
        graph = helper.make_graph(
            self.nodes, "g", self.inputs, [self.output], initializer=self.initializers
        )
        model = helper.make_model(
            graph, opset_imports=[helper.make_opsetid("", self.opset)], ir_version=10
        )
        helper.set_model_props(model, self.metadata)
        return model

    def save(self, path):
        path.write_bytes(self.model().SerializeToString())
        return path


def test_a_file_made_elsewhere_needs_no_metadata(poses, tmp_path):
    opened = OnnxGenerator(Graph().save(tmp_path / "theirs.onnx"))
    assert opened.name == "theirs" and (opened.generate(poses, 0) == 40).all()


def test_float_images_declare_their_range(poses, tmp_path):
    graph = Graph(-0.5, TensorProto.FLOAT, ("B", 1, 128, 128))
    with pytest.raises(RacinesError, match="racines.output is absent.*'unit'"):
        OnnxGenerator(graph.save(tmp_path / "f.onnx"))
    graph.metadata = {"racines.output": "unit", "racines.name": "half"}
    opened = OnnxGenerator(graph.save(tmp_path / "f.onnx"))
    assert opened.name == "half" and (opened.generate(poses, 0) == 64).all()


@pytest.mark.parametrize("value", [1.5, -255.0, float("nan"), float("inf")])
def test_images_out_of_range_are_refused(poses, tmp_path, value):
    graph = Graph(value, TensorProto.FLOAT)
    graph.metadata = {"racines.output": "unit"}
    with pytest.raises(RacinesError, match=r"give finite values in \[-1, 1\]"):
        OnnxGenerator(graph.save(tmp_path / "f.onnx")).generate(poses, 0)


def test_a_shape_that_differs_when_it_runs_is_refused(poses, tmp_path):
    graph = Graph(shape=("B", 64, 128))
    graph.output = helper.make_tensor_value_info("images", TensorProto.UINT8, ["B", None, 128])
    with pytest.raises(RacinesError, match="64, 128"):
        OnnxGenerator(graph.save(tmp_path / "s.onnx")).generate(poses, 0)


def test_a_fixed_batch_is_kept_to(poses, tmp_path):
    graph = Graph()
    graph.inputs = [helper.make_tensor_value_info("parameters", TensorProto.FLOAT, [3, 12])]
    graph.output = helper.make_tensor_value_info("images", TensorProto.UINT8, [3, 128, 128])
    opened = OnnxGenerator(graph.save(tmp_path / "b.onnx"))
    assert opened.interface.batch == 3 and opened.generate(poses, 0).shape == (50, 128, 128)


def _input(name, kind, shape):
    return lambda g: setattr(g, "inputs", [helper.make_tensor_value_info(name, kind, shape)])


def _with_noise(graph):
    graph.inputs.append(helper.make_tensor_value_info("noise", TensorProto.FLOAT, ["B", "K"]))


def _external(graph):
    tensor = graph.initializers[0]
    tensor.ClearField("raw_data")
    tensor.data_location = TensorProto.EXTERNAL
    tensor.external_data.add(key="location", value="/etc/passwd")


def _external_in_branch(graph):
    hidden = Graph()
    _external(hidden)
    node = helper.make_node("Constant", [], ["c"], value=hidden.initializers[0])
    branch = helper.make_graph([node], "b", [], [hidden.output])
    condition = numpy_helper.from_array(np.array(True), "condition")
    graph.initializers.append(condition)
    graph.nodes.append(
        helper.make_node("If", ["condition"], ["other"], then_branch=branch, else_branch=branch)
    )


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (_external, "lies in another file"),
        (_external_in_branch, "lies in another file"),
        (lambda g: setattr(g, "opset", 8), "opset 8: export with one of 11 to"),
        (lambda g: g.nodes.append(helper.make_node("Nope", ["count"], ["x"])), "not a valid ONNX"),
        (_input("parameters", TensorProto.FLOAT, ["B", 6]), r"shape \(\?, 6\): give float32"),
        (_input("parameters", TensorProto.DOUBLE, ["B", 12]), "ONNX type 11"),
        (_with_noise, "noise has 0 numbers"),
        (lambda g: setattr(g, "metadata", {"racines.name": "../x"}), "'../x' is refused"),
        (lambda g: setattr(g, "metadata", {"racines.color": "x"}), "racines.color: unknown"),
        (lambda g: setattr(g, "metadata", {"racines.output": "unit"}), "set it to 'gray'"),
        (lambda g: setattr(g, "metadata", {"racines.stochastic": "true"}), "no noise input"),
        (lambda g: setattr(g, "metadata", {"racines.noise": '{"size": 9}'}), "racines.noise: give"),
        (lambda g: setattr(g, "metadata", {"racines.card": "["}), "not valid JSON"),
        (lambda g: setattr(g, "metadata", {"racines.schema": "x/2"}), "not racines.onnx-generator"),
    ],
)
def test_files_against_the_interface_are_refused(tmp_path, spoil, message):
    graph = Graph()
    spoil(graph)
    path = graph.save(tmp_path / "spoiled.onnx")
    with pytest.raises(RacinesError, match=message) as caught:
        OnnxGenerator(path)
    assert str(path) in str(caught.value)


def test_operators_beyond_the_standard_are_refused(tmp_path):
    model = Graph().model()
    model.opset_import.append(helper.make_opsetid("com.stranger", 1))
    (tmp_path / "x.onnx").write_bytes(model.SerializeToString())
    with pytest.raises(RacinesError, match="com.stranger"):
        OnnxGenerator(tmp_path / "x.onnx")


def test_what_is_no_model_is_refused(vae_gan, tmp_path, monkeypatch):
    path = tmp_path / "x.onnx"
    whole = vae_gan[1].read_bytes()
    for content in (b"", b"\x80\x04\x95pickled", whole[: len(whole) // 2]):
        path.write_bytes(content)
        with pytest.raises(RacinesError, match="not a.* ONNX model"):
            OnnxGenerator(path)
    with pytest.raises(RacinesError, match="no such file"):
        OnnxGenerator(tmp_path / "absent.onnx")
    with pytest.raises(RacinesError, match="no run folder"):
        open_generator(str(vae_gan[1]), tmp_path)
    monkeypatch.setattr("racines_models.exchange.onnx.file.MAX_BYTES", 1000)
    with pytest.raises(RacinesError, match="at most 1,000 are read"):
        OnnxGenerator(vae_gan[1])
