"""SSD-MobileNetV2 boxes of 23 Open Images classes, by the LiteRT runtime: a second opinion.

The detector that MediaPipe Objectron ships. It knows desks, tables, boxes and monitors, which the
COCO classes of the first detector lack or blur.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from hoi.detect.backends import DetectedBox
from hoi.detect.config import SsdConfig
from hoi.detect.labels import OIDV4
from hoi.detect.models import SSD_OIDV4
from hoi.detect.nanodet import suppress

SIDE = 300
_CELLS = (19, 10, 5, 3, 2, 1)
_SCALES = (*np.linspace(0.2, 0.95, 6).tolist(), 1.0)
_RATIOS = (1.0, 2.0, 0.5, 3.0, 0.3333)
_VARIANCES = np.array([10.0, 10.0, 5.0, 5.0])  # of cy, cx, h, w, as in the model's training


class SsdOidV4:
    """A :class:`hoi.detect.backends.BoxDetector`.

    Args:
        config: its settings.
        models_dir: folder with ``ssd_oidv4.tflite``.
    """

    def __init__(self, config: SsdConfig, models_dir: Path):
        from ai_edge_litert.interpreter import Interpreter

        self.config = config
        self._model = Interpreter(model_path=str(models_dir / SSD_OIDV4), num_threads=1)
        self._model.allocate_tensors()
        self._input = self._model.get_input_details()[0]["index"]
        self._outputs = {
            int(detail["shape"][-1]): detail["index"] for detail in self._model.get_output_details()
        }
        self._anchors = anchors()

    def __call__(self, image: np.ndarray) -> list[DetectedBox]:
        """Boxes over the recording floor, best first. The picture is stretched to a square."""
        small = cv2.resize(image, (SIDE, SIDE), interpolation=cv2.INTER_AREA)
        self._model.set_tensor(self._input, small[None].astype(np.float32) / 127.5 - 1)
        self._model.invoke()
        offsets = self._model.get_tensor(self._outputs[4])[0]
        logits = self._model.get_tensor(self._outputs[1 + len(OIDV4)])[0, :, 1:]  # 0: background
        scores = 1 / (1 + np.exp(-logits.astype(np.float64)))
        height, width = image.shape[:2]
        boxes = decode(offsets.astype(np.float64), self._anchors) * (width, height, width, height)
        boxes[:, 0::2] = boxes[:, 0::2].clip(0, width)
        boxes[:, 1::2] = boxes[:, 1::2].clip(0, height)
        return suppress(scores, boxes, self.config.floor, self.config.nms_iou, OIDV4)


def anchors() -> np.ndarray:
    """(1917, 4) cy, cx, height, width of the anchors, in shares of the input."""
    parts = []
    for level, cells in enumerate(_CELLS):
        if level == 0:
            shapes = [(0.1, 1.0), (_SCALES[0], 2.0), (_SCALES[0], 0.5)]
        else:
            between = (_SCALES[level] * _SCALES[level + 1]) ** 0.5
            shapes = [(_SCALES[level], ratio) for ratio in _RATIOS] + [(between, 1.0)]
        sizes = np.array([(scale / ratio**0.5, scale * ratio**0.5) for scale, ratio in shapes])
        rows, columns = np.divmod(np.arange(cells * cells), cells)
        centres = (np.stack([rows, columns], 1) + 0.5) / cells
        parts.append(
            np.concatenate(
                [centres.repeat(len(shapes), 0), np.tile(sizes, (len(centres), 1))], axis=1
            )
        )
    return np.concatenate(parts)


def decode(offsets: np.ndarray, anchor_boxes: np.ndarray) -> np.ndarray:
    """(N, 4) x0, y0, x1, y1 in shares of the input, from the network's offsets (N, 4)."""
    scaled = offsets / _VARIANCES
    centres = scaled[:, :2] * anchor_boxes[:, 2:] + anchor_boxes[:, :2]
    halves = np.exp(np.clip(scaled[:, 2:], -10, 10)) * anchor_boxes[:, 2:] / 2
    low, high = centres - halves, centres + halves
    return np.stack([low[:, 1], low[:, 0], high[:, 1], high[:, 0]], axis=1)
