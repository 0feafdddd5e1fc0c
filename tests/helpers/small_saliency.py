"""A salient-object network as an ONNX file of a few hundred bytes, which is sure that what is red is the object."""

from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

REDNESS = np.array([32.0, -16.0, -16.0], np.float32).reshape(1, 3, 1, 1)
"""Of an image with (level - MEAN) / DEVIATION: grey gives 0, and the ball of ball_scene.py 21."""
MEAN, DEVIATION = [128.0] * 3, [256.0] * 3
NORMALIZATION = ["--mean", *map(str, MEAN), "--deviation", *map(str, DEVIATION)]
"""These as options."""


def write_network(path: Path, channels: int = 3, outputs: int = 1, sigmoid: bool = True, side_px: int = 128) -> None:
    """Write it; other channels, outputs or values beyond 0 to 1 are for the refusals."""
    weights = np.repeat(np.resize(REDNESS, (1, channels, 1, 1)), outputs, 0)
    nodes = [helper.make_node("Conv", ["image", "weights", "bias"], ["redness"])]
    nodes += [helper.make_node("Sigmoid", ["redness"], ["saliency"])] if sigmoid else []
    graph = helper.make_graph(
        nodes,
        "saliency",
        [helper.make_tensor_value_info("image", TensorProto.FLOAT, [1, channels, side_px, side_px])],
        [helper.make_tensor_value_info("saliency" if sigmoid else "redness", TensorProto.FLOAT, [1, outputs, side_px, side_px])],
        [numpy_helper.from_array(weights, "weights"), numpy_helper.from_array(np.full(outputs, -6.0, np.float32), "bias")],
    )
    onnx.save(helper.make_model(graph, ir_version=10, opset_imports=[helper.make_opsetid("", 17)]), path)
