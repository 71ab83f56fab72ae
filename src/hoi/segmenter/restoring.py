"""From the file that ships back to a network that can be trained on.

The file has no batch norms left: they are folded into the convolutions before them. Here every
batch norm becomes one that changes nothing but the bias, and then gets the statistics of real
inputs, so that training, which normalises by the statistics of each batch, starts from the same
function.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import onnx
import torch
from onnx import numpy_helper
from torch import Tensor, nn

from hoi.errors import AssetError
from hoi.segmenter.files import load_model
from hoi.segmenter.network import SegmentationNetwork
from hoi.segmenter.samples import Batch

SUFFIX = ".onnx.gz"


def restored(path: Path | str) -> SegmentationNetwork:
    """The network of a file written by :func:`hoi.segmenter.export.write_weights`.

    In evaluation mode it computes what the file computes; see :func:`calibrate` for training.
    Raises AssetError when the file is missing or holds another network.
    """
    graph = onnx.load_from_string(load_model(path)).graph
    stored = {item.name: torch.tensor(numpy_helper.to_array(item)) for item in graph.initializer}
    layers = [node for node in graph.node if node.op_type in ("Conv", "Gemm")]
    network = SegmentationNetwork().eval()
    modules = _in_order(network)
    norms = _followed_by_norms(network)
    if len(layers) != len(modules):
        raise AssetError(f"{path}: {len(layers)} layers, this version's network has {len(modules)}")
    with torch.no_grad():
        for layer, module in zip(layers, modules, strict=True):
            held = [stored[name] for name in layer.input[1:3] if name in stored]
            shapes = [value.shape for value in held]
            if shapes != [module.weight.shape, module.weight.shape[:1]]:
                raise AssetError(f"{path}: {layer.name} is not the layer of this version's network")
            weight, bias = held
            module.weight.copy_(weight)
            if module in norms:
                norm = norms[module]
                norm.weight.fill_((1 + norm.eps) ** 0.5)
                norm.bias.copy_(bias)
            else:
                assert module.bias is not None
                module.bias.copy_(bias)
    return network


def calibrate(network: SegmentationNetwork, batches: Iterable[Batch]) -> None:
    """Give every batch norm the mean and variance of what it sees; the function stays the same.

    Args:
        network: a restored one, changed in place.
        batches: typical inputs.
    """
    norms = list(_followed_by_norms(network).values())
    sums = {norm: torch.zeros(3, norm.num_features, dtype=torch.float64) for norm in norms}

    def note(norm: nn.Module, inputs: tuple[Tensor, ...], _: Tensor) -> None:
        values = inputs[0].double()
        total = sums[norm]  # type: ignore[index]
        total[0] += values.sum((0, 2, 3))
        total[1] += (values**2).sum((0, 2, 3))
        total[2] += values[:, 0].numel()

    hooks = [norm.register_forward_hook(note) for norm in norms]
    network.eval()
    with torch.no_grad():
        for batch in batches:
            network(torch.from_numpy(batch.picture), torch.from_numpy(batch.prompt))
        for hook in hooks:
            hook.remove()
        for norm in norms:
            first, second, count = sums[norm]
            mean = first / count
            variance = second / count - mean**2
            old_mean, old_variance = norm.running_mean, norm.running_var
            assert old_mean is not None and old_variance is not None
            gain = norm.weight / torch.sqrt(old_variance + norm.eps)
            norm.bias.copy_(norm.bias + gain * (mean - old_mean))
            norm.weight.copy_(gain * torch.sqrt(variance + norm.eps))
            old_mean.copy_(mean)
            old_variance.copy_(variance)


def _in_order(network: SegmentationNetwork) -> list[nn.Conv2d | nn.Linear]:
    """The layers with weights in the order in which they are run, which is that of the file."""
    order: list[nn.Conv2d | nn.Linear] = []

    def note(layer: nn.Module, *_: object) -> None:
        assert isinstance(layer, nn.Conv2d | nn.Linear)
        order.append(layer)

    layers = [item for item in network.modules() if isinstance(item, nn.Conv2d | nn.Linear)]
    hooks = [layer.register_forward_hook(note) for layer in layers]
    with torch.no_grad():
        network(torch.zeros(1, 3, 64, 64), torch.zeros(1, 2, 64, 64))
    for hook in hooks:
        hook.remove()
    return order


def _followed_by_norms(network: SegmentationNetwork) -> dict[nn.Module, nn.BatchNorm2d]:
    """The batch norm behind each convolution that has one."""
    return {
        first: second
        for block in network.modules()
        if isinstance(block, nn.Sequential)
        for first, second in zip(list(block)[:-1], list(block)[1:], strict=True)
        if isinstance(second, nn.BatchNorm2d)
    }
