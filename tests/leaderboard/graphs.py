"""Hand-made ONNX graphs with the generator's and the policy's interface; some of them harmful."""

from pathlib import Path
from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

FOREVER = 2**62


def constant(name: str, value: Any, dtype: Any = np.int64) -> Any:
    return numpy_helper.from_array(np.array(value, dtype), name)


def save(path: Path, nodes: list, inputs: list, made: Any, initializers: list, **told) -> Path:
    graph = helper.make_graph(nodes, "g", inputs, [made], initializer=initializers)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=10)
    helper.set_model_props(model, {f"racines.{key}": value for key, value in told.items()})
    path.write_bytes(model.SerializeToString())
    return path


def loop(carried: str, first: str, kind: int, shape: list, body: list, values: list) -> Any:
    """Return a Loop of 2**62 turns whose body makes `next` of `now`."""
    inputs = [
        helper.make_tensor_value_info("turn", TensorProto.INT64, []),
        helper.make_tensor_value_info("on", TensorProto.BOOL, []),
        helper.make_tensor_value_info("now", kind, shape),
    ]
    outputs = [
        helper.make_tensor_value_info("still", TensorProto.BOOL, []),
        helper.make_tensor_value_info("next", kind, shape),
    ]
    nodes = [helper.make_node("Identity", ["on"], ["still"]), *body]
    graph = helper.make_graph(nodes, "body", inputs, outputs, initializer=values)
    return helper.make_node("Loop", ["turns", "yes", first], [carried], body=graph)


def harmful(path: Path, how: str) -> Path:
    """Write a generator that is sound by its interface: it loops (`loop`) or allocates without end.

    `grow` allocates a little a turn; `claim` asks for terabytes at once.
    """
    parameters = helper.make_tensor_value_info("parameters", TensorProto.FLOAT, [8, 12])
    images = helper.make_tensor_value_info("images", TensorProto.FLOAT, [8, 128, 128])
    common = [constant("turns", FOREVER), constant("yes", True, bool)]
    seed = helper.make_node("ReduceMean", ["parameters"], ["seed"], keepdims=0)
    one = [constant("one", 1.0, np.float32)]
    if how == "loop":
        body = [helper.make_node("Mul", ["now", "one"], ["next"])]
        run = [loop("last", "seed", TensorProto.FLOAT, [], body, one)]
    elif how == "grow":
        body = [helper.make_node("Concat", ["now", "now"], ["next"], axis=0)]
        flat = helper.make_node("Reshape", ["parameters", "flat"], ["row"])
        common.append(constant("flat", [-1]))
        grown = loop("all", "row", TensorProto.FLOAT, ["n"], body, [])
        run = [flat, grown, helper.make_node("ReduceMean", ["all"], ["last"], keepdims=0)]
    else:
        common.append(constant("huge", [2**40]))
        huge = helper.make_node("ConstantOfShape", ["huge"], ["all"])
        mean = helper.make_node("ReduceMean", ["all"], ["more"], keepdims=0)
        run = [huge, mean, helper.make_node("Add", ["more", "seed"], ["last"])]
    common.append(constant("shape", [8, 128, 128]))
    nodes = [seed, *run, helper.make_node("Expand", ["last", "shape"], ["images"])]
    told = {"stochastic": "false", "conditional": "true", "output": "unit"}
    return save(path, nodes, [parameters], images, common, **told)


DECLARED = {"stochastic": "true", "conditional": "true"}


def sound_generator(
    path: Path, speckle: float = 0.02, steep: float = -6.0, **told: str | None
) -> Path:
    """Write a generator of stripes whose gray follows pose and noise, and says so.

    It draws no noise where `speckle` is 0, no pose where `steep` is; a metadata value of None is
    left out.
    """
    inputs = [
        helper.make_tensor_value_info("parameters", TensorProto.FLOAT, ["B", 12]),
        helper.make_tensor_value_info("noise", TensorProto.FLOAT, ["B", 128]),
    ]
    images = helper.make_tensor_value_info("images", TensorProto.FLOAT, ["B", 128, 128])
    # The higher the probe, the darker the frames; so steep a line is nearest to the phantom's.
    depth = np.linspace(-0.3, -1.5, 128, dtype=np.float32).reshape(1, 128, 1)
    values = [constant("depth", depth, np.float32), constant("axes", [1])]
    values += [
        constant("small", speckle, np.float32),
        constant("eight", [8]),
        constant("nine", [9]),
    ]
    values += [
        constant("last", [1]),
        constant("rows", [1, 2]),
        constant("steep", steep, np.float32),
    ]
    nodes = [
        helper.make_node("Unsqueeze", ["noise", "axes"], ["lines"]),
        helper.make_node("Mul", ["lines", "small"], ["speckle"]),
        helper.make_node("Slice", ["parameters", "eight", "nine", "last"], ["height"]),
        helper.make_node("Mul", ["height", "steep"], ["gray"]),
        helper.make_node("ReduceSum", ["gray", "last"], ["sum"], keepdims=1),
        helper.make_node("Unsqueeze", ["sum", "rows"], ["shift4"]),
        helper.make_node("Squeeze", ["shift4", "rows"], ["shift"]),
        helper.make_node("Unsqueeze", ["shift", "axes"], ["shift3"]),
        helper.make_node("Add", ["depth", "speckle"], ["plain"]),
        helper.make_node("Add", ["plain", "shift3"], ["bright"]),
        helper.make_node("Tanh", ["bright"], ["images"]),
    ]
    about = {"name": "stripes", "output": "unit"} | DECLARED | told
    about = {key: value for key, value in about.items() if value is not None}
    return save(path, nodes, inputs, images, values, **about)


def spoilt_generator(path: Path, how: str) -> Path:
    """Write the sound generator with something behind it that breaks the contract."""
    model = onnx.load(sound_generator(path, steep=0.0 if how == "one pixel" else -6.0))
    graph, node = model.graph, helper.make_node
    graph.node[-1].output[0] = "drawn"
    pixel = np.zeros((1, 128, 128), np.float32)
    pixel[0, 64, 64] = 5.0
    graph.initializer.extend(
        [constant("zero", [0]), constant("half", 0.5, np.float32), constant("pixel", pixel, "f4"),
         constant("dim", 0.004, np.float32), constant("one", 1.0, np.float32)]
    )  # fmt: skip
    graph.node.extend(
        {
            "batch": [
                node("ReduceMean", ["drawn", "zero"], ["mean"]),
                node("Mul", ["mean", "half"], ["share"]),
                node("Sub", ["drawn", "share"], ["images"]),
            ],
            "chance": [
                node("RandomNormalLike", ["drawn"], ["chance"], scale=0.05, seed=1.0),
                node("Add", ["drawn", "chance"], ["shaken"]),
                node("Tanh", ["shaken"], ["images"]),
            ],
            "black": [
                node("Mul", ["drawn", "dim"], ["faint"]),
                node("Add", ["faint", "dim"], ["above"]),
                node("Sub", ["above", "one"], ["images"]),
            ],
            "one pixel": [
                node("Mul", ["shift3", "pixel"], ["dot"]),
                node("Slice", ["parameters", "eight", "nine", "last"], ["high"]),
                node("Unsqueeze", ["high", "axes"], ["high3"]),
                node("Mul", ["high3", "pixel"], ["spot"]),
                node("Add", ["drawn", "spot"], ["more"]),
                node("Add", ["more", "dot"], ["images"]),
            ],
        }[how]
    )
    path.write_bytes(model.SerializeToString())
    return path


def blind_policy(path: Path, sees: str) -> Path:
    """Write a policy that declares to see the pose (`params`), or the image too, and ignores one.

    `params`: it always takes the same action; `multimodal`: it goes by the pose alone; `batch`: by
    what its neighbours see.
    """
    params = helper.make_tensor_value_info("params", TensorProto.FLOAT, ["B", 9])
    image = helper.make_tensor_value_info("image", TensorProto.UINT8, ["B", 128, 128])
    logits = helper.make_tensor_value_info("logits", TensorProto.FLOAT, ["B", 13])
    matrix = np.random.default_rng(0).normal(size=(9, 13)).astype(np.float32)
    values = [constant("matrix", matrix, np.float32), constant("zero", 0.0, np.float32)]
    values += [constant("first", [0]), constant("axes", [1, 2])]
    values += [constant("always", np.eye(13)[:1], np.float32)]
    nodes = [helper.make_node("MatMul", ["params", "matrix"], ["own"])]
    if sees == "params":
        nodes += [helper.make_node("Mul", ["own", "zero"], ["none"])]
        nodes += [helper.make_node("Add", ["none", "always"], ["logits"])]
    elif sees == "batch":
        nodes += [helper.make_node("ReduceMean", ["own", "first"], ["mean"])]
        nodes += [helper.make_node("Sub", ["own", "mean"], ["logits"])]
    else:
        nodes += [helper.make_node("Cast", ["image"], ["gray"], to=TensorProto.FLOAT)]
        nodes += [helper.make_node("ReduceMean", ["gray", "axes"], ["level"], keepdims=0)]
        nodes += [helper.make_node("Unsqueeze", ["level", "one"], ["column"])]
        nodes += [helper.make_node("Mul", ["column", "faint"], ["little"])]
        nodes += [helper.make_node("Add", ["own", "little"], ["logits"])]
        values += [constant("one", [1]), constant("faint", 1e-9, np.float32)]
    inputs = [params, image] if sees == "multimodal" else [params]
    return save(path, nodes, inputs, logits, values, name="blind")


def sound_policy(path: Path, seed: int = 0, **told: str) -> Path:
    """Write a policy of the pose alone: one matrix, drawn by a seed."""
    params = helper.make_tensor_value_info("params", TensorProto.FLOAT, ["B", 9])
    logits = helper.make_tensor_value_info("logits", TensorProto.FLOAT, ["B", 13])
    matrix = np.random.default_rng(seed).normal(size=(9, 13)).astype(np.float32)
    node = helper.make_node("MatMul", ["params", "matrix"], ["logits"])
    return save(
        path,
        [node],
        [params],
        logits,
        [constant("matrix", matrix, np.float32)],
        name="line",
        **told,
    )


def lookup_generator(
    path: Path, parameters: Any, images: Any, noise: float = 0.0, conditional: str = "true"
) -> Path:
    """Write a generator that looks frames up by the nearest pose: a table of (N, 12) and images.

    With `noise`, so many gray levels of it hide that its images are copies.
    """
    table = np.asarray(parameters, np.float32)
    values = [constant("table", np.nan_to_num(table)[None], np.float32), constant("one", [1])]
    values += [constant("frames", images, np.uint8), constant("last", [2])]
    nodes = [
        helper.make_node("Unsqueeze", ["parameters", "one"], ["rows"]),
        helper.make_node("Sub", ["rows", "table"], ["apart"]),
        helper.make_node("Mul", ["apart", "apart"], ["squares"]),
        helper.make_node("ReduceSum", ["squares", "last"], ["distance"], keepdims=0),
        helper.make_node("ArgMin", ["distance"], ["nearest"], axis=1, keepdims=0),
    ]
    inputs = [helper.make_tensor_value_info("parameters", TensorProto.FLOAT, ["B", 12])]
    about = {"name": "lookup", "conditional": conditional}
    kind = TensorProto.FLOAT if noise else TensorProto.UINT8
    made = helper.make_tensor_value_info("images", kind, ["B", 128, 128])
    if not noise:
        nodes += [helper.make_node("Gather", ["frames", "nearest"], ["images"], axis=0)]
        return save(path, nodes, inputs, made, values, **about, output="gray", stochastic="false")
    inputs += [helper.make_tensor_value_info("noise", TensorProto.FLOAT, ["B", 128 * 128])]
    values += [constant("square", [-1, 128, 128]), constant("scale", 1 / 127.5, np.float32)]
    values += [constant("least", -1.0, np.float32), constant("most", 1.0, np.float32)]
    values += [constant("level", noise / 127.5, np.float32)]
    nodes += [
        helper.make_node("Gather", ["frames", "nearest"], ["found"], axis=0),
        helper.make_node("Cast", ["found"], ["gray"], to=TensorProto.FLOAT),
        helper.make_node("Mul", ["gray", "scale"], ["scaled"]),
        helper.make_node("Add", ["scaled", "least"], ["unit"]),
        helper.make_node("Mul", ["noise", "level"], ["small"]),
        helper.make_node("Reshape", ["small", "square"], ["speckle"]),
        helper.make_node("Add", ["unit", "speckle"], ["hidden"]),
        helper.make_node("Clip", ["hidden", "least", "most"], ["images"]),
    ]
    return save(path, nodes, inputs, made, values, **about, output="unit", stochastic="true")


def lookup_policy(path: Path, seen: Any, actions: Any, **told: str) -> Path:
    """Write a policy that knows what to do where it was told, (M, 9) and (M,), and nowhere else."""
    params = helper.make_tensor_value_info("params", TensorProto.FLOAT, ["B", 9])
    logits = helper.make_tensor_value_info("logits", TensorProto.FLOAT, ["B", 13])
    values = [constant("table", np.asarray(seen)[None], np.float32), constant("one", [1])]
    values += [constant("told", np.eye(13)[np.asarray(actions)], np.float32)]
    values += [constant("last", [2]), constant("near", 1e-9, np.float32)]
    values += [constant("always", np.eye(13)[:1], np.float32)]
    nodes = [
        helper.make_node("Unsqueeze", ["params", "one"], ["rows"]),
        helper.make_node("Sub", ["rows", "table"], ["apart"]),
        helper.make_node("Mul", ["apart", "apart"], ["squares"]),
        helper.make_node("ReduceSum", ["squares", "last"], ["distance"], keepdims=0),
        helper.make_node("ArgMin", ["distance"], ["nearest"], axis=1, keepdims=0),
        helper.make_node("ReduceMin", ["distance", "one"], ["least"], keepdims=1),
        helper.make_node("Less", ["least", "near"], ["known"]),
        helper.make_node("Gather", ["told", "nearest"], ["wanted"], axis=0),
        helper.make_node("Where", ["known", "wanted", "always"], ["logits"]),
    ]
    return save(path, nodes, [params], logits, values, name="lookup", **told)
