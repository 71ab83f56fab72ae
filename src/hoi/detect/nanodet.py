"""NanoDet-g boxes of the 80 COCO classes, by OpenCV's network runtime."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from hoi.detect.backends import Box, DetectedBox
from hoi.detect.config import NanoDetConfig
from hoi.detect.labels import COCO80
from hoi.detect.models import NANODET_ONNX

SIDE = 416
STRIDES = (8, 16, 32)
_MEAN_BGR = np.array([103.53, 116.28, 123.675], np.float32)
_STD_BGR = np.array([57.375, 57.12, 58.395], np.float32)
_SCORES = ("Identity_out", "Identity_1_out", "Identity_2_out")
_DISTANCES = ("Identity_3_out", "Identity_4_out", "Identity_5_out")


class NanoDet:
    """A :class:`hoi.detect.backends.BoxDetector`.

    Args:
        config: its settings.
        models_dir: folder with the converted model.
    """

    def __init__(self, config: NanoDetConfig, models_dir: Path):
        self.config = config
        self._net = cv2.dnn.readNetFromONNX(str(models_dir / NANODET_ONNX))

    def __call__(self, image: np.ndarray) -> list[DetectedBox]:
        """Boxes over the recording floor, best first."""
        pixels, scale, offset = letterbox(image, SIDE)
        normalised = (pixels[..., ::-1].astype(np.float32) - _MEAN_BGR) / _STD_BGR
        self._net.setInput(np.ascontiguousarray(normalised.transpose(2, 0, 1)[None]))
        outputs = [np.asarray(part) for part in self._net.forward([*_SCORES, *_DISTANCES])]
        scores, boxes = decode(outputs[:3], outputs[3:])
        boxes = (boxes - np.tile(offset, 2)) / scale
        boxes[:, 0::2] = boxes[:, 0::2].clip(0, image.shape[1])
        boxes[:, 1::2] = boxes[:, 1::2].clip(0, image.shape[0])
        return suppress(scores, boxes, self.config.floor, self.config.nms_iou)


def letterbox(image: np.ndarray, side: int) -> tuple[np.ndarray, float, np.ndarray]:
    """The image scaled into a black square, with (scale, (left, top)) of square from image."""
    height, width = image.shape[:2]
    scale = side / max(height, width)
    size = max(round(width * scale), 1), max(round(height * scale), 1)
    shrunk = cv2.resize(
        image, size, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    )
    left, top = (side - size[0]) // 2, (side - size[1]) // 2
    square = np.zeros((side, side, 3), np.uint8)
    square[top : top + size[1], left : left + size[0]] = shrunk
    return square, scale, np.array([left, top], np.float64)


def decode(scores: list[np.ndarray], distances: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Class scores (N, 80) and boxes (N, 4) in network pixels.

    Each cell predicts, per side of the box, a distribution over 11 distances in strides.
    """
    boxes = []
    for stride, logits in zip(STRIDES, distances, strict=True):
        cells = SIDE // stride
        rows, columns = np.divmod(np.arange(cells * cells), cells)
        centres = (np.stack([columns, rows], 1) + 0.5) * stride
        logits = logits.reshape(cells * cells, 4, -1).astype(np.float64)
        shares = np.exp(logits - logits.max(-1, keepdims=True))
        shares /= shares.sum(-1, keepdims=True)
        reach = shares @ np.arange(shares.shape[-1]) * stride
        boxes.append(np.concatenate([centres - reach[:, :2], centres + reach[:, 2:]], 1))
    flat = [part.reshape(-1, len(COCO80)) for part in scores]
    return np.concatenate(flat), np.concatenate(boxes)


def suppress(
    scores: np.ndarray,
    boxes: np.ndarray,
    floor: float,
    nms_iou: float,
    names: Sequence[str] = COCO80,
) -> list[DetectedBox]:
    """Non-maximum suppression class by class; boxes over `floor`, best first.

    `scores` (N, C) of the classes `names`, `boxes` (N, 4) in pixels.
    """
    cells, classes = np.nonzero(scores >= floor)
    if not len(cells):
        return []
    sizes = np.concatenate([boxes[cells, :2], boxes[cells, 2:] - boxes[cells, :2]], 1)
    values = scores[cells, classes].astype(np.float32)
    kept = cv2.dnn.NMSBoxesBatched(
        sizes.tolist(), values.tolist(), classes.tolist(), floor, nms_iou
    )
    found = [
        DetectedBox(names[int(classes[index])], float(values[index]), _box(boxes[cells[index]]))
        for index in np.asarray(kept, int).reshape(-1)
    ]
    return sorted(found, key=lambda item: (-item.score, item.label, item.box))


def _box(values: np.ndarray) -> Box:
    x0, y0, x1, y1 = (round(float(value), 3) for value in values)
    return x0, y0, x1, y1
