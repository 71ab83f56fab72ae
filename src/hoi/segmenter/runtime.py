"""Run the segmenter on a photo with OpenCV alone."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from hoi.errors import AssetError
from hoi.segmenter.crops import (
    MARGIN,
    SIDE,
    box_crop,
    crop_matrix,
    cropped,
    network_inputs,
    pasted,
    picture_crop,
)
from hoi.segmenter.files import load_model

DEFAULT_WEIGHTS = Path(__file__).parents[1] / "data" / "segmenter" / "segmenter.onnx.gz"


class MaskNetwork:
    """The loaded network.

    Args:
        weights: a file written by :func:`hoi.segmenter.files.halved`.

    Raises AssetError when the file is missing or no segmenter.
    """

    def __init__(self, weights: Path | str = DEFAULT_WEIGHTS):
        model = np.frombuffer(load_model(weights), np.uint8)
        try:
            self._net = cv2.dnn.readNetFromONNX(model)
        except cv2.error as error:
            raise AssetError(f"{weights}: OpenCV cannot read the network: {error}") from error

    def __call__(
        self, image: np.ndarray, box: Sequence[float], person: np.ndarray, margin: float = MARGIN
    ) -> np.ndarray:
        """(H, W) float32 probability of every pixel to be the object in the box.

        Args:
            image: (H, W, 3) uint8 RGB.
            box: x0, y0, x1, y1 in pixels.
            person: (H, W) probability of the person who interacts; zeros when unknown.
            margin: side of the crop / longer side of the box.
        """
        matrix = crop_matrix(box, margin=margin)
        people = cropped(np.asarray(person, np.float32), matrix)
        picture, prompt = network_inputs(
            picture_crop(image, matrix)[None],
            box_crop(box, matrix, image.shape[:2])[None],
            np.rint(np.clip(people, 0, 1) * 255).astype(np.uint8)[None],
        )
        self._net.setInput(picture, "picture")
        self._net.setInput(prompt, "prompt")
        logits = np.asarray(self._net.forward()).reshape(SIDE // 2, SIDE // 2)
        logits = cv2.resize(logits, (SIDE, SIDE), interpolation=cv2.INTER_LINEAR)
        crop = 1 / (1 + np.exp(-np.clip(logits, -30, 30)))
        return pasted(crop.astype(np.float32), matrix, image.shape[:2], 0.0)
