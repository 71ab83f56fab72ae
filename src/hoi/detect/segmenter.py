"""An object's mask from its box by the network of :mod:`hoi.segmenter`, edges by GrabCut."""

from __future__ import annotations

import cv2
import numpy as np

from hoi.detect.backends import Box, ObjectSegmenter, PersonPose
from hoi.detect.boxes import grown, longer_side, pixel_window
from hoi.detect.config import DetectConfig, SegmenterConfig
from hoi.detect.grabcut import GrabCut
from hoi.segmenter.runtime import MaskNetwork


def object_segmenter_of(config: DetectConfig) -> ObjectSegmenter:
    """The segmenter that `config.object_masks` names."""
    colours = GrabCut(config.grabcut, config.blazepose.visible)
    if config.object_masks == "grabcut":
        return colours
    return Segmenter(config.segmenter, MaskNetwork(), colours)


class Segmenter:
    """An :class:`hoi.detect.backends.ObjectSegmenter`.

    Sources it reports: ``segmenter``; ``segmenter_grabcut`` where GrabCut settled the unsure
    pixels; and those of `fallback`, which answers where the network finds next to nothing. A person
    mask that fills the box is not shown to the network: pose models swallow what people hug, wear
    and ride.
    """

    def __init__(self, config: SegmenterConfig, network: MaskNetwork, fallback: ObjectSegmenter):
        self.config = config
        self._network = network
        self._fallback = fallback

    def __call__(
        self, image: np.ndarray, box: Box, pose: PersonPose, seed: int
    ) -> tuple[np.ndarray, str]:
        probability = self.probability(image, box, pose)
        mask = probability > self.config.threshold
        window = pixel_window(box, *image.shape[:2])
        needed = max(self.config.minimum_fill * mask[window].size, 1.0)
        if mask[window].sum() < needed:
            return self._fallback(image, box, pose, seed)
        if self.config.refine:
            settled = refined(image, box, probability, self.config, seed)
            if settled[window].sum() >= needed:
                return settled, "segmenter_grabcut"
        return mask, "segmenter"

    def probability(self, image: np.ndarray, box: Box, pose: PersonPose) -> np.ndarray:
        """(H, W) what the network says of every pixel."""
        window = pixel_window(box, *image.shape[:2])
        share = float((pose.probability[window] > 0.5).mean()) if image[window].size else 0.0
        person = pose.probability
        if share >= self.config.swallowed:
            person = np.zeros_like(person)
        return self._network(image, box, person, self.config.margin)


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
