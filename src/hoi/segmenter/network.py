"""The network: a COCO detector's backbone, and a decoder that a box and a person mask steer.

The backbone is that of NanoDet-g with its feature pyramid and class logits: what it learned of
eighty classes on photos is what makes a decoder trained on renders work on photos at all. The
decoder (0.8 million parameters) fuses strides 32, 16 and 8, compares every pixel's feature with
those of a coarse foreground and background, and refines at strides 4 and 2.
"""

from __future__ import annotations

from pathlib import Path

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from hoi.errors import AssetError

#: channels in, channels out, kernel of the backbone's convolutions, in the order of their names
_CONVOLUTIONS = (
    (3, 32, 3), (32, 32, 3), (32, 16, 3), (16, 16, 3), (32, 32, 3),
    (64, 64, 3), (64, 32, 3), (32, 32, 3), (64, 32, 3), (32, 32, 3), (64, 64, 3),
    (128, 128, 3), (128, 64, 3), (64, 64, 3), (128, 64, 3), (64, 64, 3), (128, 128, 3),
    (256, 256, 3), (256, 128, 3), (128, 128, 3), (256, 128, 3), (128, 128, 3), (256, 128, 3),
    (128, 128, 3), (256, 256, 3),
    (128, 128, 1), (256, 128, 1), (512, 128, 1),
    (128, 128, 3), (128, 80, 1), (128, 128, 3), (128, 80, 1), (128, 128, 3), (128, 80, 1),
)  # fmt: skip
_STRIDE_2 = (0, 5, 11, 17)
_KEPT = 5  # the stem and the first stage see edges and colours: they stay as they are
_SLOPE = 0.1
CLASSES = 80
PROMPTS = 3  # box, person, box without person


def _up(features: Tensor, like: Tensor) -> Tensor:
    return F.interpolate(features, size=like.shape[2:], mode="bilinear", align_corners=False)


class Backbone(nn.Module):
    """NanoDet-g without its box branch; any input size that is a multiple of 32."""

    def __init__(self):
        super().__init__()
        self.convs = nn.ModuleList(
            nn.Conv2d(inputs, outputs, kernel, 2 if i in _STRIDE_2 else 1, kernel // 2)
            for i, (inputs, outputs, kernel) in enumerate(_CONVOLUTIONS)
        )

    def _run(self, index: int, features: Tensor) -> Tensor:
        return F.leaky_relu(self.convs[index](features), _SLOPE)

    def _tiny(self, index: int, features: Tensor) -> Tensor:
        first = self._run(index, features)
        return torch.cat([self._run(index + 1, first), first], 1)

    def _stage(self, index: int, features: Tensor, count: int) -> Tensor:
        """A cross-stage block of `count` small ones, with a shortcut round them."""
        shortcut = inner = self._run(index, features)
        for step in range(count):
            inner = self._tiny(index + 1 + 2 * step, inner)
        return torch.cat([self._run(index + 1 + 2 * count, inner), shortcut], 1)

    def forward(self, picture: Tensor) -> tuple[list[Tensor], list[Tensor], list[Tensor]]:
        """Features at strides 4, 8, 16, 32; head features and class logits at 8, 16, 32."""
        convs, run = self.convs, self._run
        stem = F.max_pool2d(run(0, picture), 3, 2, 1)
        s4 = self._stage(1, stem, 1)
        s8 = self._stage(5, s4, 2)
        s16 = self._stage(11, s8, 2)
        s32 = self._stage(17, s16, 3)
        l8, l16, l32 = convs[25](s8), convs[26](s16), convs[27](s32)
        p16 = l16 + _up(l32, l16)
        p8 = l8 + _up(p16, l8)
        p16 = p16 + _up(p8, p16)
        p32 = l32 + _up(p16, l32)
        heads = [run(28, p8), run(30, p16), run(32, p32)]
        logits = [convs[29](heads[0]), convs[31](heads[1]), convs[33](heads[2])]
        return [s4, s8, s16, s32], heads, logits


def load_backbone(nanodet: Path) -> Backbone:
    """The backbone with the weights of the converted detector, see :mod:`hoi.detect.models`.

    Raises AssetError when the file is not that detector.
    """
    import onnx
    from onnx import numpy_helper

    backbone = Backbone()
    try:
        graph = onnx.load(str(nanodet)).graph
        values = {item.name: item for item in graph.initializer}
        added = {node.input[0]: node.input[1] for node in graph.node if node.op_type == "Add"}
        with torch.no_grad():
            for index, conv in enumerate(backbone.convs):
                assert isinstance(conv, nn.Conv2d)
                name = "PartitionedCall/convolution" + (f"_{index}" if index else "")
                weight = numpy_helper.to_array(values[f"{name}/kernel"])
                bias = numpy_helper.to_array(values[added[name]]).reshape(-1)
                # the class logits come first, the box branch after them is not needed
                conv.weight.copy_(torch.tensor(weight[: conv.out_channels]))
                conv.bias.copy_(torch.tensor(bias[: conv.out_channels]))  # type: ignore[union-attr]
    except (OSError, KeyError, RuntimeError, ValueError) as error:
        raise AssetError(f"{nanodet} is not the converted NanoDet-g: {error}") from error
    return backbone


def _block(inputs: int, outputs: int, kernel: int = 3, dilation: int = 1) -> nn.Sequential:
    padding = dilation * (kernel // 2)
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, kernel, 1, padding, dilation, bias=False),
        nn.BatchNorm2d(outputs),
        nn.LeakyReLU(_SLOPE, True),
    )


class SegmentationNetwork(nn.Module):
    """Picture and prompt in, mask logits out.

    Args:
        backbone: a loaded one; by default an untrained one, to be filled by ``load_state_dict``.
        width, fine, finest: channels of the decoder at strides 8 to 32, at 4, and at 2.
    """

    def __init__(
        self, backbone: Backbone | None = None, width: int = 80, fine: int = 80, finest: int = 16
    ):
        super().__init__()
        head = 128 + CLASSES + PROMPTS
        self.backbone = backbone or Backbone()
        self.stem = nn.Sequential(
            nn.Conv2d(3 + PROMPTS, finest, 5, 2, 2), nn.LeakyReLU(_SLOPE, True)
        )
        self.enter4 = _block(64 + PROMPTS, fine, 1)
        self.enter8 = _block(128 + head, width, 1)
        self.enter16 = _block(256 + head, width, 1)
        self.enter32 = _block(512 + head, width, 1)
        self.mix32 = _block(width, width)
        self.mix16 = nn.Sequential(_block(2 * width, width), _block(width, width))
        self.mix8 = nn.Sequential(
            _block(2 * width, width), _block(width, width, 3, 2), _block(width, width)
        )
        self.coarse = nn.Conv2d(width, 1, 1)
        self.modulate = nn.Linear(2 * width, 2 * width)
        self.to_fine = nn.Conv2d(width + 3, fine, 1)
        self.mix4 = nn.Sequential(_block(2 * fine, fine), _block(fine, fine))
        self.shuffle = nn.Conv2d(fine, 4 * finest, 1)
        self.last = nn.Sequential(
            nn.Conv2d(2 * finest, finest + 8, 3, 1, 1),
            nn.LeakyReLU(_SLOPE, True),
            nn.Conv2d(finest + 8, 1, 3, 1, 1),
        )

    def forward(self, picture: Tensor, prompt: Tensor) -> tuple[Tensor, Tensor]:
        """Logits (B, 1, S/2, S/2), and coarse ones (B, 1, S/8, S/8) for a second loss.

        Args:
            picture, prompt: see :func:`hoi.segmenter.crops.network_inputs`.
        """
        box, person = prompt[:, :1], prompt[:, 1:2]
        prompts = torch.cat([prompt, box * (1 - person)], 1)
        p4 = F.avg_pool2d(prompts, 4)
        p8 = F.avg_pool2d(p4, 2)
        p16 = F.avg_pool2d(p8, 2)
        p32 = F.avg_pool2d(p16, 2)
        (s4, s8, s16, s32), (h8, h16, h32), (c8, c16, c32) = self.backbone(picture)
        x2 = self.stem(torch.cat([picture, prompts], 1))
        x4 = self.enter4(torch.cat([s4, p4], 1))
        x8 = self.enter8(torch.cat([s8, h8, c8 * 0.1, p8], 1))
        x16 = self.enter16(torch.cat([s16, h16, c16 * 0.1, p16], 1))
        x32 = self.mix32(self.enter32(torch.cat([s32, h32, c32 * 0.1, p32], 1)))
        x16 = self.mix16(torch.cat([_up(x32, x16), x16], 1))
        x8 = self.mix8(torch.cat([_up(x16, x8), x8], 1))
        coarse = self.coarse(x8)
        x8 = self._compared(x8, coarse)
        x4 = self.mix4(torch.cat([_up(x8, x4), x4], 1))
        return self.last(torch.cat([F.pixel_shuffle(self.shuffle(x4), 2), x2], 1)), coarse

    def _compared(self, features: Tensor, coarse: Tensor) -> Tensor:
        """Features that know how alike they are to the mean foreground and background."""
        share = coarse.float().sigmoid()
        whole = features.float()

        def mean(weight: Tensor) -> Tensor:
            return (whole * weight).sum((2, 3)) / (weight.sum((2, 3)) + 1e-3)

        inside, outside = mean(share), mean(1 - share)
        unit = F.normalize(whole, dim=1)
        alike = [
            (unit * F.normalize(kind, dim=1)[..., None, None]).sum(1, keepdim=True)
            for kind in (inside, outside)
        ]
        gain, offset = self.modulate(torch.cat([inside, outside], 1)).chunk(2, 1)
        changed = whole * (1 + gain[..., None, None]) + offset[..., None, None]
        return self.to_fine(torch.cat([changed, coarse.float(), *alike], 1).to(features.dtype))

    def train_only_decoder(self) -> None:
        """Keep the whole backbone as it is."""
        self.backbone.requires_grad_(False)

    def train_backbone_too(self) -> None:
        """Let the backbone learn from stride 8 on."""
        self.backbone.requires_grad_(True)
        for index in range(_KEPT):
            self.backbone.convs[index].requires_grad_(False)
