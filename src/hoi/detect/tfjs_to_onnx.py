"""Convert a static TensorFlow.js graph to ONNX, for the operators that NanoDet uses.

TensorFlow runs images as (N, H, W, C), ONNX as (N, C, H, W). Every operator that cares is wrapped
in transposes, and a transpose of a transpose is folded at once.
"""

from __future__ import annotations

import base64
import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from hoi.errors import AssetError

OPSET, IR_VERSION = 17, 9
_NCHW_FROM_NHWC, _NHWC_FROM_NCHW = (0, 3, 1, 2), (0, 2, 3, 1)
_IDENTITY = (0, 1, 2, 3)


def convert(graph_file: Path) -> bytes:
    """The ONNX model of a TensorFlow.js graph (`graph_file` and the weight files beside it).

    Inputs and outputs keep their names and layouts. Equal files give equal bytes. Raises AssetError
    for an operator that is not known here.
    """
    document = json.loads(graph_file.read_text())
    graph = _Graph(
        nodes={node["name"]: node for node in document["modelTopology"]["node"]},
        constants=_read_weights(document, graph_file.parent),
    )
    signature = document["signature"]
    names = sorted(key.split(":")[0] for key in signature["outputs"])
    for name in names:
        graph.emit(name)
    shapes = {key.split(":")[0]: _shape(value) for key, value in signature["outputs"].items()}
    inputs = [
        helper.make_tensor_value_info(key.split(":")[0], TensorProto.FLOAT, _shape(value))
        for key, value in sorted(signature["inputs"].items())
    ]
    outputs = []
    for name in names:
        graph.add("Identity", [graph.tensors[name]], f"{name}_out")
        outputs.append(
            helper.make_tensor_value_info(f"{name}_out", TensorProto.FLOAT, shapes[name])
        )
    nodes, initialisers = graph.reachable([f"{name}_out" for name in names])
    body = helper.make_graph(nodes, "graph", inputs, outputs, initialisers)
    model = helper.make_model(body, opset_imports=[helper.make_opsetid("", OPSET)])
    model.ir_version = IR_VERSION
    onnx.checker.check_model(model)
    return model.SerializeToString(deterministic=True)


def _shape(value: dict) -> list[int]:
    return [int(dimension["size"]) for dimension in value["tensorShape"]["dim"]]


def _read_weights(document: dict, folder: Path) -> dict[str, np.ndarray]:
    """Name -> array. Weights stored as float16 come back as float32."""
    weights = {}
    for group in document["weightsManifest"]:
        data = b"".join((folder / Path(name).name).read_bytes() for name in group["paths"])
        offset = 0
        for entry in group["weights"]:
            stored = entry.get("quantization", {}).get("dtype", entry["dtype"])
            if "scale" in entry.get("quantization", {}):
                raise AssetError(f"{folder}: weight {entry['name']} has an integer quantisation")
            count = int(np.prod(entry["shape"], dtype=int))
            array = np.frombuffer(data, np.dtype(stored), count, offset)
            offset += array.nbytes
            weights[entry["name"]] = array.reshape(entry["shape"]).astype(entry["dtype"])
    return weights


def _attribute(node: dict, name: str, default: Any = None) -> Any:
    """A TensorFlow.js attribute as a Python value."""
    value = node.get("attr", {}).get(name)
    if value is None:
        return default
    if "list" in value:
        return [int(item) for item in value["list"].get("i", [])]
    if "s" in value:
        return base64.b64decode(value["s"]).decode()
    return {"i": int, "f": float, "b": bool}[next(iter(value))](next(iter(value.values())))


@dataclass
class _Graph:
    """The ONNX graph under construction."""

    nodes: dict[str, dict]
    constants: dict[str, np.ndarray]
    tensors: dict[str, str] = field(default_factory=dict)  # TensorFlow name -> ONNX tensor
    emitted: list[onnx.NodeProto] = field(default_factory=list)  # parents before children
    transposed: dict[str, tuple[str, tuple[int, ...]]] = field(default_factory=dict)

    def add(self, op: str, inputs: list[str], output: str | list[str], **attributes) -> str:
        outputs = [output] if isinstance(output, str) else output
        node = helper.make_node(op, inputs, outputs, name=outputs[0], **attributes)
        self.emitted.append(node)
        return outputs[0]

    def constant(self, value: Any, name: str, dtype: Any = None) -> str:
        self.constants[name] = np.ascontiguousarray(value, dtype)
        return name

    def transpose(self, tensor: str, order: tuple[int, ...], name: str) -> str:
        source, before = self.transposed.get(tensor, (tensor, _IDENTITY[: len(order)]))
        total = tuple(before[axis] for axis in order)
        if total == tuple(range(len(total))):
            return source
        self.transposed[name] = (source, total)
        return self.add("Transpose", [source], name, perm=list(total))

    def value(self, reference: str) -> np.ndarray:
        """The array of a constant tensor; the graph computes some of its shapes."""
        name = reference.split(":")[0]
        if name in self.constants:
            return self.constants[name]
        node = self.nodes[name]
        operands = [self.value(item) for item in node.get("input", [])]
        if node["op"] in ("Add", "AddV2"):
            return operands[0] + operands[1]
        if node["op"] == "SparseToDense":
            indices, shape, values, default = operands
            dense = np.full(shape, default)
            dense[tuple(np.atleast_2d(indices).T)] = values
            return dense
        raise AssetError(f"constant operator {node['op']} of {name} is not known")

    def tensor(self, reference: str) -> str:
        """The ONNX tensor of `name` or `name:output`."""
        name, _, index = reference.partition(":")
        self.emit(name)
        base = self.tensors[name]
        return base if index in ("", "0") else f"{base}:{index}"

    def emit(self, name: str) -> None:
        """Add the nodes that compute `name`."""
        if name in self.tensors:
            return
        if name in self.constants or self.nodes[name]["op"] == "Placeholder":
            self.tensors[name] = name
            return
        node = self.nodes[name]
        build = _BUILDERS.get(node["op"])
        if build is None:
            raise AssetError(f"operator {node['op']} of {name} is not known")
        self.tensors[name] = build(self, node, name, node.get("input", []))

    def reachable(self, outputs: list[str]) -> tuple[list[onnx.NodeProto], list[TensorProto]]:
        """The nodes and initialisers that `outputs` depend on."""
        wanted, nodes = set(outputs), []
        for node in reversed(self.emitted):
            if wanted.intersection(node.output):
                nodes.append(node)
                wanted.update(node.input)
        used = sorted(name for name in wanted if name in self.constants)
        return nodes[::-1], [numpy_helper.from_array(self.constants[name], name) for name in used]


def _transpose(graph: _Graph, node: dict, name: str, inputs: list[str]) -> str:
    order = tuple(int(axis) for axis in graph.value(inputs[1]))
    return graph.transpose(graph.tensor(inputs[0]), order, name)


def _as_nchw(graph: _Graph, op: str, tensors: list[str], name: str, **attributes) -> str:
    image = graph.transpose(tensors[0], _NCHW_FROM_NHWC, f"{name}/nchw")
    result = graph.add(op, [image, *tensors[1:]], f"{name}/result", **attributes)
    return graph.transpose(result, _NHWC_FROM_NCHW, name)


def _padding(node: dict) -> str:
    return "SAME_UPPER" if _attribute(node, "padding") == "SAME" else "VALID"


def _convolution(graph: _Graph, node: dict, name: str, inputs: list[str]) -> str:
    kernel = graph.constant(graph.value(inputs[1]).transpose(3, 2, 0, 1), f"{name}/kernel")
    return _as_nchw(
        graph,
        "Conv",
        [graph.tensor(inputs[0]), kernel],
        name,
        strides=_attribute(node, "strides")[1:3],
        dilations=_attribute(node, "dilations", [1] * 4)[1:3],
        auto_pad=_padding(node),
    )


def _max_pool(graph: _Graph, node: dict, name: str, inputs: list[str]) -> str:
    return _as_nchw(
        graph,
        "MaxPool",
        [graph.tensor(inputs[0])],
        name,
        kernel_shape=_attribute(node, "ksize")[1:3],
        strides=_attribute(node, "strides")[1:3],
        auto_pad=_padding(node),
    )


def _resize(graph: _Graph, node: dict, name: str, inputs: list[str]) -> str:
    # The height and width are known, batch and channels are kept by a scale of one.
    if _attribute(node, "align_corners") or not _attribute(node, "half_pixel_centers"):
        raise AssetError(f"{name}: only bilinear resizing with half-pixel centres is known")
    image = graph.transpose(graph.tensor(inputs[0]), _NCHW_FROM_NHWC, f"{name}/nchw")
    shape = graph.add("Shape", [image], f"{name}/shape", start=0, end=2)
    size = graph.constant(graph.value(inputs[1]), f"{name}/size", np.int64)
    sizes = graph.add("Concat", [shape, size], f"{name}/sizes", axis=0)
    result = graph.add(
        "Resize",
        [image, "", "", sizes],
        f"{name}/result",
        mode="linear",
        coordinate_transformation_mode="half_pixel",
    )
    return graph.transpose(result, _NHWC_FROM_NCHW, name)


def _pad(graph: _Graph, node: dict, name: str, inputs: list[str]) -> str:
    # TensorFlow lists (before, after) per axis, ONNX all befores and then all afters.
    amounts = graph.constant(graph.value(inputs[1]).T.reshape(-1), f"{name}/amounts", np.int64)
    fill = float(graph.value(inputs[2])) if len(inputs) > 2 else 0.0
    # The padding of a max pool is minus infinity in all but name.
    value = graph.constant(np.float32(max(fill, -3e38)).reshape(()), f"{name}/value")
    return graph.add("Pad", [graph.tensor(inputs[0]), amounts, value], name)


def _concat(graph: _Graph, node: dict, name: str, inputs: list[str]) -> str:
    tensors = [graph.tensor(item) for item in inputs[:-1]]
    return graph.add("Concat", tensors, name, axis=int(graph.value(inputs[-1])))


def _split(graph: _Graph, node: dict, name: str, inputs: list[str]) -> str:
    sizes = graph.value(inputs[1])
    outputs = [name, *(f"{name}:{index}" for index in range(1, len(sizes)))]
    parts = graph.constant(sizes, f"{name}/sizes", np.int64)
    axis = int(graph.value(inputs[2]))
    return graph.add("Split", [graph.tensor(inputs[0]), parts], outputs, axis=axis)


def _reshape(graph: _Graph, node: dict, name: str, inputs: list[str]) -> str:
    shape = graph.constant(graph.value(inputs[1]), f"{name}/shape", np.int64)
    return graph.add("Reshape", [graph.tensor(inputs[0]), shape], name)


def _leaky_relu(graph: _Graph, node: dict, name: str, inputs: list[str]) -> str:
    alpha = _attribute(node, "alpha", 0.2)
    return graph.add("LeakyRelu", [graph.tensor(inputs[0])], name, alpha=alpha)


def _elementwise(op: str):
    def build(graph: _Graph, node: dict, name: str, inputs: list[str]) -> str:
        return graph.add(op, [graph.tensor(item) for item in inputs], name)

    return build


_BUILDERS = {
    "Add": _elementwise("Add"),
    "AddV2": _elementwise("Add"),
    "ConcatV2": _concat,
    "Conv2D": _convolution,
    "Identity": _elementwise("Identity"),
    "LeakyRelu": _leaky_relu,
    "MaxPool": _max_pool,
    "Pad": _pad,
    "PadV2": _pad,
    "Reshape": _reshape,
    "ResizeBilinear": _resize,
    "Sigmoid": _elementwise("Sigmoid"),
    "SplitV": _split,
    "Transpose": _transpose,
}
