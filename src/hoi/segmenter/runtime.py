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
    extent_crop,
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
        prompt = box_crop(box, matrix, image.shape[:2])
        return self._answer(image, matrix, prompt, person)

    def in_use(
        self,
        image: np.ndarray,
        window: Sequence[float],
        person: np.ndarray,
        extent: float | None = None,
    ) -> np.ndarray:
        """(H, W) float32 probability of every pixel to be the thing that a person uses.

        Without a box around the thing: this is a hint where it is, and a rough mask.

        Args:
            image: (H, W, 3) uint8 RGB.
            window: the square to look at, see :func:`hoi.segmenter.crops.used_window`.
            person: (H, W) probability of being that person.
            extent: about how many pixels long such a thing looks there; None when unknown.
        """
        matrix = crop_matrix(window, margin=1.0)
        return self._answer(image, matrix, extent_crop(extent, matrix), person)

    def _answer(
        self, image: np.ndarray, matrix: np.ndarray, prompt: np.ndarray, person: np.ndarray
    ) -> np.ndarray:
        people = cropped(np.asarray(person, np.float32), matrix)
        people = np.rint(np.clip(people, 0, 1) * 255).astype(np.uint8)
        picture, prompts = network_inputs(
            picture_crop(image, matrix)[None], prompt[None], people[None]
        )
        self._net.setInput(picture, "picture")
        self._net.setInput(prompts, "prompt")
        logits = np.asarray(self._net.forward()).reshape(SIDE // 2, SIDE // 2)
        logits = cv2.resize(logits, (SIDE, SIDE), interpolation=cv2.INTER_LINEAR)
        crop = 1 / (1 + np.exp(-np.clip(logits, -30, 30)))
        return pasted(crop.astype(np.float32), matrix, image.shape[:2], 0.0)
