"""The shipped form of the weights: an ONNX graph with half-precision weights, gzipped.

Stored, every weight is float16 with a Cast behind it, so that the file is a valid ONNX model for
any runtime. Loaded, the casts are folded: OpenCV gets plain float32 weights.
"""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from hoi.errors import AssetError

_SMALL = 16  # shapes, scales and the like stay as they are


def halved(model: onnx.ModelProto) -> bytes:
    """The gzipped file of a float32 model; equal models give equal bytes."""
    stored = onnx.ModelProto()
    stored.CopyFrom(model)
    casts = []
    for item in stored.graph.initializer:
        if item.data_type != TensorProto.FLOAT or np.prod(item.dims) < _SMALL:
            continue
        name, value = item.name, numpy_helper.to_array(item)
        if np.abs(value).max() > np.finfo(np.float16).max:
            raise AssetError(f"{name}: a weight is too large for half precision")
        half = numpy_helper.from_array(value.astype(np.float16), f"{name}.half")
        item.CopyFrom(half)
        casts.append(helper.make_node("Cast", [half.name], [name], to=TensorProto.FLOAT))
    nodes = [*casts, *stored.graph.node]
    del stored.graph.node[:]
    stored.graph.node.extend(nodes)
    onnx.checker.check_model(stored)
    return gzip.compress(stored.SerializeToString(deterministic=True), 9, mtime=0)


def widened(data: bytes) -> bytes:
    """The float32 ONNX model of a stored file.

    Raises ValueError for something else.
    """
    try:
        model = onnx.load_from_string(gzip.decompress(data))
    except Exception as error:  # protobuf and zlib have no common class of errors
        raise ValueError(f"not a gzipped ONNX model: {error}") from error
    graph = model.graph
    stored = {item.name: item for item in graph.initializer}
    kept = []
    for node in graph.node:
        item = stored.get(node.input[0]) if node.op_type == "Cast" and node.input else None
        if item is None:
            kept.append(node)
            continue
        value = numpy_helper.to_array(item).astype(np.float32)
        item.CopyFrom(numpy_helper.from_array(value, node.output[0]))
    del graph.node[:]
    graph.node.extend(kept)
    return model.SerializeToString()


def load_model(path: Path | str) -> bytes:
    """The float32 ONNX model in the file `path`; raises AssetError when there is none."""
    try:
        return widened(Path(path).read_bytes())
    except (OSError, ValueError) as error:
        raise AssetError(f"{path}: the object segmenter cannot be read: {error}") from error
