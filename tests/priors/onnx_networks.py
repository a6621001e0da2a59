"""Small ONNX networks in the forms in which LaMa is published."""

from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

FREE = ("height", "width")


def write_lama(
    path: Path, *, joined: bool = False, size: tuple = FREE, unit: float = 1.0, scale: float = 1.0
) -> Path:
    """A random convolution of image and mask, blended into the image where the mask says so.

    Args:
        path: The .onnx file.
        joined: One input of four channels, the image black where masked; else two.
        size: Height and width [px], or names for any.
        unit: Value of white at the output.
        scale: Of the weights; NaN makes the output NaN.
    """
    generator = np.random.default_rng(5)
    weights = generator.uniform(0.0, 1.0, (3, 4, 9, 9)).astype(np.float32)
    weights *= scale / weights.sum(axis=(1, 2, 3), keepdims=True)
    constants = {"weights": weights, "one": np.float32(1.0), "unit": np.float32(unit)}
    constants |= {name: np.array(ends) for name, ends in
                  {"zero": [0], "three": [3], "four": [4], "channels": [1]}.items()}  # fmt: skip
    inputs = {"input": 4} if joined else {"image": 3, "mask": 1}
    split = [
        helper.make_node("Slice", ["input", "zero", "three", "channels"], ["image"]),
        helper.make_node("Slice", ["input", "three", "four", "channels"], ["mask"]),
    ]
    together = [helper.make_node("Concat", ["image", "mask"], ["both"], axis=1)]
    nodes = [
        *(split if joined else []),
        *together,
        helper.make_node("Conv", ["both", "weights"], ["made"], pads=[4, 4, 4, 4]),
        helper.make_node("Sub", ["one", "mask"], ["known"]),
        helper.make_node("Mul", ["made", "mask"], ["inside"]),
        helper.make_node("Mul", ["image", "known"], ["outside"]),
        helper.make_node("Add", ["inside", "outside"], ["blended"]),
        helper.make_node("Mul", ["blended", "unit"], ["output"]),
    ]
    graph = helper.make_graph(
        nodes,
        "lama",
        [helper.make_tensor_value_info(n, TensorProto.FLOAT, [1, c, *size]) for n, c in inputs.items()],
        [helper.make_tensor_value_info("output", TensorProto.FLOAT, [1, 3, *size])],
        [numpy_helper.from_array(value, name) for name, value in constants.items()],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9)
    onnx.checker.check_model(model)
    onnx.save(model, path)
    return path
