"""Models that are asked with a box: Segment Anything, or any ONNX file of a stated form."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from hoi.detect.backends import Box, ObjectSegmenter, PersonPose
from hoi.detect.boxes import grown, longer_side, pixel_window
from hoi.detect.config import ModelFiles, StrongConfig
from hoi.errors import AssetError

#: RGB image, box in pixels -> (H, W) bool.
BoxModel = Callable[[np.ndarray, Box], np.ndarray]
_CONTEXT = 0.25  # surroundings of the box shown to an ONNX model, as a share of its longer side


def load_from_box(strong: StrongConfig, otherwise: ObjectSegmenter) -> ObjectSegmenter:
    """The segmenter that a resolved configuration names; `otherwise` for ``none``, and wherever
    the model finds nothing."""
    if strong.from_box == "none":
        return otherwise
    if strong.from_box == "sam":
        model: BoxModel = SegmentAnything(strong.sam, strong.device)
    else:
        model = OnnxFromBox(strong.onnx)

    def segment(image: np.ndarray, box: Box, pose: PersonPose, seed: int) -> tuple[np.ndarray, str]:
        mask = model(image, box)
        return (mask, strong.from_box) if mask.any() else otherwise(image, box, pose, seed)

    return segment


class SegmentAnything:
    """SAM by the package ``segment_anything``: code and weights Apache-2.0.

    `settings` names the size of the model: vit_b, vit_l or vit_h.
    """

    def __init__(self, files: ModelFiles, device: str):
        try:
            from segment_anything import (  # pyright: ignore[reportMissingImports]
                SamPredictor,
                sam_model_registry,
            )
        except ImportError as error:
            raise AssetError(
                f"segment_anything cannot be imported ({error}); "
                "pip install segment-anything (docs/detection.md)"
            ) from error
        size = files.settings or "vit_b"
        if size not in sam_model_registry:
            known = ", ".join(sorted(sam_model_registry))
            raise AssetError(f"strong.sam.settings: no model {size!r}; known: {known}")
        self._predictor = SamPredictor(
            sam_model_registry[size](checkpoint=files.weights).to(device)
        )

    def __call__(self, image: np.ndarray, box: Box) -> np.ndarray:
        self._predictor.set_image(np.ascontiguousarray(image))
        masks, _, _ = self._predictor.predict(box=np.array(box), multimask_output=False)
        return np.asarray(masks[0]) > 0.5


class OnnxFromBox:
    """An ONNX file run by OpenCV: inputs ``image`` (1, 3, S, S), RGB in [0, 1], and ``box`` (1, 4),
    x0, y0, x1, y1 in pixels of that square; the first output (1, 1, h, w) holds logits.

    `settings` is S, 512 if empty.
    """

    def __init__(self, files: ModelFiles):
        self._side = int(files.settings or 512)
        try:
            self._net = cv2.dnn.readNetFromONNX(files.weights)
        except cv2.error as error:
            raise AssetError(
                f"{files.weights}: not an ONNX file OpenCV can run: {error}"
            ) from error

    def __call__(self, image: np.ndarray, box: Box) -> np.ndarray:
        side = (1 + 2 * _CONTEXT) * longer_side(box)
        x, y = (box[0] + box[2] - side) / 2, (box[1] + box[3] - side) / 2
        zoom = self._side / max(side, 1.0)
        # OpenCV counts from pixel centres
        crop_from_image = np.array(
            [[zoom, 0, -x * zoom + (zoom - 1) / 2], [0, zoom, -y * zoom + (zoom - 1) / 2]]
        )
        square = cv2.warpAffine(image, crop_from_image, (self._side, self._side))
        corners = (np.array(box) - [x, y, x, y]) * zoom
        self._net.setInput(square.transpose(2, 0, 1)[None].astype(np.float32) / 255, "image")
        self._net.setInput(corners[None].astype(np.float32), "box")
        logits = np.asarray(self._net.forward())
        if logits.ndim != 4:
            raise AssetError(f"the ONNX model answers {logits.shape}, expected (1, 1, h, w)")
        drawn = cv2.resize(logits[0, 0], (self._side, self._side), interpolation=cv2.INTER_LINEAR)
        height, width = image.shape[:2]
        mask = np.zeros((height, width), bool)
        window = pixel_window(grown(box, _CONTEXT * longer_side(box)), height, width)
        back = cv2.warpAffine(
            drawn,
            crop_from_image,
            (width, height),
            flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
            borderValue=-10.0,
        )
        mask[window] = back[window] > 0
        return mask
