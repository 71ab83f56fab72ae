"""GrabCut settles the pixels that a probability leaves open."""

from __future__ import annotations

import cv2
import numpy as np

from hoi.detect.backends import Box
from hoi.detect.boxes import grown, longer_side, pixel_window
from hoi.detect.config import SegmenterConfig


def refined(
    image: np.ndarray, box: Box, probability: np.ndarray, config: SegmenterConfig, seed: int
) -> np.ndarray:
    """(H, W) bool: a mask whose unsure pixels are settled by their colours.

    Args:
        image: (H, W, 3) uint8 RGB.
        box: around the object.
        probability: (H, W) of being the object.
    """
    mask = probability > config.threshold
    rows, columns = pixel_window(grown(box, config.context * longer_side(box)), *mask.shape)
    shown = image[rows, columns]
    scale = min(1.0, config.longest_side / max(*shown.shape[:2], 1))
    size = max(round(shown.shape[1] * scale), 2), max(round(shown.shape[0] * scale), 2)
    if min(shown.shape[:2]) < 2:
        return mask
    small = cv2.resize(shown, size, interpolation=cv2.INTER_AREA)
    chance = cv2.resize(probability[rows, columns], size, interpolation=cv2.INTER_AREA)
    labels = np.where(chance > config.threshold, cv2.GC_PR_FGD, cv2.GC_PR_BGD).astype(np.uint8)
    labels[chance < config.sure_background] = cv2.GC_BGD
    labels[chance > config.sure_foreground] = cv2.GC_FGD
    inside = np.isin(labels, (cv2.GC_FGD, cv2.GC_PR_FGD))
    if inside.all() or not inside.any():
        return mask
    # GrabCut seeds its colour clusters from OpenCV's own generator.
    cv2.setRNGSeed(seed % (2**31))
    models = np.zeros((1, 65)), np.zeros((1, 65))
    lab = cv2.cvtColor(small, cv2.COLOR_RGB2LAB)
    mode = cv2.GC_INIT_WITH_MASK
    cv2.grabCut(lab, labels, (0, 0, 0, 0), *models, config.iterations, mode)
    found = np.isin(labels, (cv2.GC_FGD, cv2.GC_PR_FGD)).astype(np.float32)
    mask[rows, columns] = cv2.resize(found, shown.shape[1::-1]) > 0.5
    return mask
