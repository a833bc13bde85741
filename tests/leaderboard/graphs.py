"""Hand-made ONNX graphs with the generator's and the policy's interface; some of them harmful."""

from pathlib import Path
from typing import Any

import numpy as np
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
    return save(path, nodes, [parameters], images, common, output="unit")


def sound_generator(path: Path) -> Path:
    """Write a generator of stripes whose gray follows pose and noise."""
    inputs = [
        helper.make_tensor_value_info("parameters", TensorProto.FLOAT, ["B", 12]),
        helper.make_tensor_value_info("noise", TensorProto.FLOAT, ["B", 128]),
    ]
    images = helper.make_tensor_value_info("images", TensorProto.FLOAT, ["B", 128, 128])
    depth = np.linspace(0.6, -0.6, 128, dtype=np.float32).reshape(1, 128, 1)
    values = [constant("depth", depth, np.float32), constant("axes", [1])]
    values += [constant("small", 0.02, np.float32), constant("six", [6]), constant("nine", [9])]
    values += [constant("last", [1]), constant("rows", [1, 2])]
    nodes = [
        helper.make_node("Unsqueeze", ["noise", "axes"], ["lines"]),
        helper.make_node("Mul", ["lines", "small"], ["speckle"]),
        helper.make_node("Slice", ["parameters", "six", "nine", "last"], ["place"]),
        helper.make_node("ReduceSum", ["place", "last"], ["sum"], keepdims=1),
        helper.make_node("Unsqueeze", ["sum", "rows"], ["shift4"]),
        helper.make_node("Squeeze", ["shift4", "rows"], ["shift"]),
        helper.make_node("Unsqueeze", ["shift", "axes"], ["shift3"]),
        helper.make_node("Add", ["depth", "speckle"], ["plain"]),
        helper.make_node("Add", ["plain", "shift3"], ["bright"]),
        helper.make_node("Tanh", ["bright"], ["images"]),
    ]
    return save(path, nodes, inputs, images, values, name="stripes", output="unit")


def sound_policy(path: Path) -> Path:
    """Write a policy of the pose alone: one matrix."""
    params = helper.make_tensor_value_info("params", TensorProto.FLOAT, ["B", 9])
    logits = helper.make_tensor_value_info("logits", TensorProto.FLOAT, ["B", 13])
    matrix = np.random.default_rng(0).normal(size=(9, 13)).astype(np.float32)
    node = helper.make_node("MatMul", ["params", "matrix"], ["logits"])
    return save(
        path, [node], [params], logits, [constant("matrix", matrix, np.float32)], name="line"
    )
