"""From trained weights to the file that ships."""

from __future__ import annotations

import io
import warnings
from pathlib import Path

import onnx
import torch
from torch import Tensor, nn

from hoi.segmenter.crops import SIDE
from hoi.segmenter.files import halved
from hoi.segmenter.network import SegmentationNetwork

OPSET = 17


class _Final(nn.Module):
    """The network without its coarse output."""

    def __init__(self, network: SegmentationNetwork):
        super().__init__()
        self.network = network

    def forward(self, picture: Tensor, prompt: Tensor) -> Tensor:
        return self.network(picture, prompt)[0]


def exported(network: SegmentationNetwork) -> onnx.ModelProto:
    """The float32 ONNX model: inputs ``picture`` and ``prompt``, output ``logit``; one picture."""
    final = _Final(network).eval()  # batch norms are folded in this mode only
    example = torch.zeros(1, 3, SIDE, SIDE), torch.zeros(1, 2, SIDE, SIDE)
    buffer = io.BytesIO()
    with torch.no_grad(), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the exporter that needs no extra package is the old one
        torch.onnx.export(
            final,
            example,
            buffer,  # type: ignore[arg-type]  # a stream is documented, too
            opset_version=OPSET,
            input_names=["picture", "prompt"],
            output_names=["logit"],
            dynamo=False,
        )
    model = onnx.load_from_string(buffer.getvalue())
    onnx.checker.check_model(model)
    return model


def write_weights(network: SegmentationNetwork, path: Path | str) -> None:
    """Write the shipped form of a network."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(path.name + ".partial")
    partial.write_bytes(halved(exported(network)))
    partial.replace(path)
